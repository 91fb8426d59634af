"""The arithmetic of the learning, against what it is by hand or by torch's own distributions."""

import pytest

torch = pytest.importorskip("torch", reason="needs the extra `training`: pip install -e '.[training]'")

from typing import Any  # noqa: E402

from tests.training.play import REMEMBERING  # noqa: E402
from training.environment.insertion import AIM, PRIVILEGED_SIZE  # noqa: E402
from training.environment.vector import Ended  # noqa: E402
from training.learning import ppo  # noqa: E402
from training.learning.experiment import AlgorithmSection  # noqa: E402
from training.learning.network import ActorCritic  # noqa: E402
from training.learning.rollout import Rollout  # noqa: E402

NOTHING: Any = None


def rollout(**given: Any) -> Rollout:
    steps, cells = given["reward"].shape
    zero = torch.zeros(steps, cells)
    thin = torch.zeros(steps, cells, 1)
    nothing = {"features": thin, "action": thin, "log_density": zero, "value": zero, "begins": zero, "ends": zero}
    after = {"hidden": thin[0], "last_value": zero[0], "ended": NOTHING, "simulating_s": 0.0}
    return Rollout(**(nothing | after | given))


def test_with_lambda_one_an_advantage_is_the_discounted_return_less_what_was_expected() -> None:
    reward = torch.tensor([[1.0], [2.0], [4.0]])
    value = torch.tensor([[0.5], [0.25], [0.125]])
    played = rollout(reward=reward, value=value, last_value=torch.tensor([8.0]))
    returns = [1 + 0.5 * 2 + 0.25 * 4 + 0.125 * 8, 2 + 0.5 * 4 + 0.25 * 8, 4 + 0.5 * 8]
    torch.testing.assert_close(played.advantages(0.5, 1.0), torch.tensor(returns)[:, None] - value)


def test_with_lambda_zero_an_advantage_looks_one_step_ahead() -> None:
    played = rollout(
        reward=torch.tensor([[1.0], [2.0]]), value=torch.tensor([[3.0], [5.0]]), last_value=torch.tensor([7.0])
    )
    wanted = torch.tensor([[1 + 0.9 * 5 - 3], [2 + 0.9 * 7 - 5]])
    torch.testing.assert_close(played.advantages(0.9, 0.0), wanted)


def test_nothing_flows_back_over_the_end_of_an_episode() -> None:
    value = torch.tensor([[1.0], [2.0], [3.0]])
    ends = torch.tensor([[0.0], [1.0], [0.0]])
    quiet, loud = (
        rollout(reward=torch.tensor([[1.0], [1.0], [last]]), value=value, ends=ends).advantages(0.99, 0.95)
        for last in (0.0, 100.0)
    )
    assert torch.equal(quiet[:2], loud[:2])
    torch.testing.assert_close(quiet[1], torch.tensor([1.0 - 2.0]))
    assert quiet[2] != loud[2]


def test_the_log_density_is_a_normal_distributions_but_for_a_constant() -> None:
    network = ActorCritic(REMEMBERING, 8, 32, -0.3)
    mean, actions = torch.randn(5, 4), torch.randn(2, 5, 4)
    normal = torch.distributions.Normal(mean, network.log_std.exp())
    with torch.no_grad():
        wanted = normal.log_prob(actions).sum(-1)
        got = network.log_density(actions, mean)
    torch.testing.assert_close(got[0] - got[1], wanted[0] - wanted[1])


def played_about(network: ActorCritic, best: float, truth: float, steps: int = 16, cells: int = 32) -> Rollout:
    """Steps whose reward is larger the nearer an action is to `best`, and where the hole is at `truth`."""
    features = torch.cat(
        [torch.randn(steps, cells, network.seen) * network.normalise.scale, torch.randn(steps, cells, PRIVILEGED_SIZE)],
        -1,
    )
    features[..., network.seen :][..., AIM] = truth
    hidden, begins = torch.zeros(cells, network.hidden), torch.zeros(steps, cells)
    with torch.no_grad():
        perceived, memories = network.remember_sequence(features[..., : network.seen], hidden, begins)
        mean, _ = network.act(perceived, memories)
        action = mean + network.log_std.exp() * torch.randn_like(mean)
        value = network.value(features, memories)
    return Rollout(
        features,
        action,
        network.log_density(action, mean).detach(),
        value,
        -((action - best) ** 2).sum(-1),
        begins,
        torch.ones(steps, cells),  # every step stands for itself
        hidden,
        torch.zeros(cells),
        Ended(*(torch.zeros(0).numpy() for _ in range(5))),  # type: ignore[arg-type]
        0.0,
    )


def test_updates_move_the_policy_to_what_earns_more_and_the_guess_to_where_the_hole_is() -> None:
    torch.manual_seed(0)
    network = ActorCritic(REMEMBERING, 32, 32, -0.7)
    algorithm = AlgorithmSection(steps=1, cells=32, learning_rate=2e-3, hidden=32)
    optimiser = torch.optim.Adam(network.parameters(), algorithm.learning_rate)
    first = last = ppo.update(network, optimiser, played_about(network, 0.4, 0.7), algorithm)
    for _ in range(30):
        last = ppo.update(network, optimiser, played_about(network, 0.4, 0.7), algorithm)
    with torch.no_grad():
        perceived, hidden = network.remember(torch.zeros(1, network.seen), network.initial_hidden(1))
        mean, guess = network.act(perceived, hidden)
    assert (mean - 0.4).abs().max() < 0.15
    assert (guess - 0.7).abs().max() < 0.15
    assert last.value_loss < first.value_loss
    assert last.auxiliary_loss < 0.1 * first.auxiliary_loss
    assert 0.0 <= last.kl < 0.1


def test_without_its_weight_the_auxiliary_head_learns_nothing() -> None:
    network = ActorCritic(REMEMBERING, 8, 32, -0.7)
    before = [value.clone() for value in network.aux.parameters()]
    algorithm = AlgorithmSection(steps=1, cells=32, hidden=32, auxiliary_weight=0.0)
    ppo.update(network, torch.optim.Adam(network.parameters()), played_about(network, 0.4, 0.7), algorithm)
    assert all(torch.equal(old, new) for old, new in zip(before, network.aux.parameters(), strict=True))
