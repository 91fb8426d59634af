"""Inputs and memory of the network."""

from typing import Any

import pytest

torch = pytest.importorskip("torch", reason="needs the extra `training`: pip install -e '.[training]'")

from tests.training.play import REMEMBERING, SHORT  # noqa: E402
from training.environment.insertion import PRIVILEGED_SIZE  # noqa: E402
from training.learning.network import ActorCritic  # noqa: E402

STEPS, CELLS = 6, 3


@pytest.fixture(params=["untrained", "remembering"])
def network(request: pytest.FixtureRequest) -> Any:
    return request.getfixturevalue(request.param)


def seen(network: Any, *shape: int) -> Any:
    return torch.randn(*shape, network.seen, generator=torch.Generator().manual_seed(3)) * network.normalise.scale


def test_a_sequence_is_its_steps_one_after_another_and_an_episodes_beginning_forgets(network: Any) -> None:
    observation, hidden = seen(network, STEPS, CELLS), torch.rand(CELLS, network.hidden)
    begins = torch.zeros(STEPS, CELLS)
    begins[2, 1] = begins[0, 2] = 1.0
    with torch.no_grad():
        perceived, memories = network.remember_sequence(observation, hidden, begins)
        for t in range(STEPS):
            alone, hidden = network.remember(observation[t], hidden * (1.0 - begins[t])[:, None])
            torch.testing.assert_close(alone, perceived[t])
            torch.testing.assert_close(hidden, memories[t])


def test_only_a_recurrent_network_is_moved_by_what_came_before(untrained: Any, remembering: Any) -> None:
    for network, moved in ((untrained, False), (remembering, True)):
        now = seen(network, 1)
        with torch.no_grad():
            fresh, later = (network.remember(now, h)[1] for h in (torch.zeros(1, 32), torch.ones(1, 32)))
        assert torch.equal(fresh, later) != moved


def test_the_actor_has_no_input_for_what_only_the_simulation_knows(network: Any) -> None:
    features = torch.cat([seen(network, CELLS), torch.randn(CELLS, PRIVILEGED_SIZE)], -1).requires_grad_()
    perceived, hidden = network.remember(features[:, : network.seen], network.initial_hidden(CELLS))
    action, guess = network.act(perceived, hidden)
    (action.sum() + guess.sum()).backward()
    assert features.grad is not None
    assert not features.grad[:, network.seen :].any()
    assert features.grad[:, : network.seen].any()


def test_neither_the_actor_nor_the_critic_trains_what_is_not_theirs(network: Any) -> None:
    def trained_by(loss: Any) -> set[str]:
        network.zero_grad()
        loss.backward()
        return {
            name.split(".")[0]
            for name, value in network.named_parameters()
            if value.grad is not None and value.grad.any()
        }

    features = torch.cat([seen(network, CELLS), torch.randn(CELLS, PRIVILEGED_SIZE)], -1)
    memory = "gru" if network.recurrent else "layer"

    def forward() -> tuple[Any, Any, Any]:
        perceived, hidden = network.remember(features[:, : network.seen], torch.ones(CELLS, network.hidden))
        return (*network.act(perceived, hidden), network.value(features, hidden))

    assert trained_by(forward()[0].sum()) == {"encoder", memory, "head"}
    assert trained_by(forward()[1].sum()) == {"encoder", memory, "aux"}
    assert trained_by(forward()[2].sum()) == {"critic"}


def test_an_untrained_policy_hardly_moves() -> None:
    for contract in (SHORT, REMEMBERING):
        fresh = ActorCritic(contract, 32, 32, -0.7)
        with torch.no_grad():
            action, _ = fresh.act(*fresh.remember(seen(fresh, 50), fresh.initial_hidden(50)))
        assert action.abs().max() < 0.2
