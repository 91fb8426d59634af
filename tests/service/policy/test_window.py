import numpy as np

from service.policy.window import summarise

WINDOW = np.arange(4 * 2 * 6, dtype=float).reshape(4, 2, 6) ** 1.5


def test_a_window_is_averaged_and_fz_keeps_its_range() -> None:
    summary = summarise(WINDOW)
    np.testing.assert_allclose(summary.mean, WINDOW.mean(0))
    np.testing.assert_allclose(summary.fz_min, WINDOW[:, :, 2].min(0))
    np.testing.assert_allclose(summary.fz_max, WINDOW[:, :, 2].max(0))
    np.testing.assert_allclose(summary.fz_std, WINDOW[:, :, 2].std(0))


def test_only_the_newest_samples_count() -> None:
    np.testing.assert_allclose(summarise(WINDOW, 2).mean, WINDOW[2:].mean(0))


def test_a_window_shorter_than_wanted_gives_what_it_has() -> None:
    np.testing.assert_allclose(summarise(WINDOW, 40).mean, WINDOW.mean(0))


def test_one_cell_is_a_batch_without_dimensions() -> None:
    assert summarise(WINDOW[:, 0]).mean.shape == (6,)
    np.testing.assert_allclose(summarise(WINDOW[:, 0]).fz_std, summarise(WINDOW).fz_std[0])
