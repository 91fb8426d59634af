"""Plants with every error, each of a modest size."""

from wire.plant import PlantErrors

EVERY = PlantErrors(
    friction_added=0.2,
    contact_time_scale=0.8,
    hole_tilt_deg=1.0,
    tcp_shift_m=1e-3,
    tcp_height_m=1e-3,
    tcp_tilt_deg=0.5,
    ft_turn_deg=3.0,
    ft_gain_error=0.1,
    ft_left_n=0.5,
    ft_left_nm=0.05,
    ft_noise_scale=1.5,
    ft_drift_scale=3.0,
    ft_delay_ticks=3,
    target_delay_ticks=5,
    target_jitter_ticks=5,
    camera_error_scale=1.5,
    camera_bias_m=1e-3,
    camera_height_m=1e-3,
    finger_stiffness_scale=0.5,
    payload_mass_scale=1.1,
    payload_shift_m=5e-3,
    joint_stiffness_scale=0.5,
    joint_friction_share=0.02,
    joint_backlash_deg=0.05,
    joint_ripple_deg=0.01,
)
"""Every error that varies from cell to cell of a world."""
ODD_PEG = PlantErrors(peg_chamfer_m=0.3e-3, peg_rounding_m=0.2e-3, peg_oversize_m=0.05e-3, peg_taper_deg=0.2)
"""Every error of the peg's shape, which all cells of a world share."""
