"""The appearance shows the cell as it is, and changes nothing that is simulated."""

import mujoco
import numpy as np
import pytest

from sim_backend.world import appearance, scene
from sim_backend.world.parts import PARTS, hole_walls


def dressed(part: str, clearance_m: float) -> mujoco.MjModel:
    spec = scene.specify(part, clearance_m)
    appearance.dress(spec, part, clearance_m)
    return spec.compile()


@pytest.mark.parametrize("part", sorted(PARTS))
def test_dressing_leaves_the_simulated_scene_as_it_is(part: str) -> None:
    plain, dressy = scene.build(part, 1e-3).model, dressed(part, 1e-3)
    assert (plain.nq, plain.nv, plain.nu, plain.nbody) == (dressy.nq, dressy.nv, dressy.nu, dressy.nbody)
    np.testing.assert_array_equal(plain.body_mass, dressy.body_mass)
    np.testing.assert_array_equal(plain.body_inertia, dressy.body_inertia)
    for geom in range(dressy.ngeom):
        name = dressy.geom(geom).name
        if not name:
            assert dressy.geom_contype[geom] == dressy.geom_conaffinity[geom] == 0
        else:
            np.testing.assert_array_equal(dressy.geom(geom).size, plain.geom(name).size)
            np.testing.assert_array_equal(dressy.geom(geom).pos, plain.geom(name).pos)
    assert {plain.geom(i).name for i in range(plain.ngeom)} <= {dressy.geom(i).name for i in range(dressy.ngeom)}


def test_the_simulated_scene_carries_nothing_to_look_at() -> None:
    model = scene.build("tr").model
    assert model.ncam == model.nlight == model.ntex == model.nmat == 0
    assert ((model.geom_contype != 0) | (model.geom_conaffinity != 0)).all()


@pytest.mark.parametrize("part", sorted(PARTS))
@pytest.mark.parametrize("clearance_m", [0.1e-3, 2e-3])
def test_the_drawn_hole_is_the_one_that_the_peg_meets(part: str, clearance_m: float) -> None:
    model = dressed(part, clearance_m)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mouth = data.mocap_pos[0]
    walls = hole_walls(PARTS[part], clearance_m)
    normals = np.stack([np.cos(walls[:, 0]), np.sin(walls[:, 0])], axis=1)
    touched = np.zeros(len(walls), bool)
    for geom in range(model.ngeom):
        mesh = model.geom_dataid[geom]
        if mesh < 0 or not model.mesh(mesh).name.startswith("wedge"):
            continue
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        local = model.mesh_vert[first : first + count]
        vertices = data.geom_xpos[geom] + local @ data.geom_xmat[geom].reshape(3, 3).T - mouth
        outside = vertices[:, :2] @ normals.T - walls[:, 1]  # (vertices, walls), positive beyond a wall's face
        faced = (np.abs(outside) < 1e-6).sum(axis=0) == 4  # a wall's face has four of the wedge's vertices
        assert faced.any()
        assert (outside.max(axis=1) > -1e-6).all()
        assert (outside[:, faced] > -1e-6).all()
        touched |= faced
    assert touched.all()
