"""A world obeys its holder alone, each command once, and is taken over only from one that has fallen silent."""

import json

import pytest

from sim_backend.holding import LEASE_S, Holding
from sim_backend.requests import RequestError
from wire import records
from wire.arrays import RecordArray
from wire.records import Kind


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def holding(clock: Clock) -> Holding:
    return Holding(clock)


def claim(holding: Holding, cell: str, word: int | None = None) -> int:
    document = json.dumps({"cell": cell, "host": "bench", "pid": 7}).encode()
    return json.loads(holding.claim("" if word is None else f"client={word}", document))["client"]


def command(kind: Kind, client: int, seq: int) -> RecordArray:
    record = records.new(records.COMMAND, kind)[0]
    record["client"], record["seq"] = client, seq
    return record


def test_81_the_second_claim_is_refused_and_names_the_first(holding: Holding, clock: Clock) -> None:
    word = claim(holding, "left")
    clock.now = 0.5
    with pytest.raises(RequestError, match=r"held by cell 'left', process 7 on bench, heard 0\.5 s ago"):
        claim(holding, "right")
    assert holding.admits(command(Kind.ENGAGE, word, 1)), "the first is not disturbed"


def test_81_a_holder_that_renews_or_commands_keeps_the_world_and_a_silent_one_loses_it(
    holding: Holding, clock: Clock
) -> None:
    word = claim(holding, "left")
    for turn in range(1, 4):
        clock.now += 0.9 * LEASE_S
        assert claim(holding, "left", word) == word
        clock.now += 0.9 * LEASE_S
        assert holding.admits(command(Kind.TARGET, word, turn))
        with pytest.raises(RequestError, match="held by"):
            claim(holding, "right")
    clock.now += 1.1 * LEASE_S
    other = claim(holding, "right")
    assert other != word
    assert not holding.admits(command(Kind.TARGET, word, 9))
    with pytest.raises(RequestError, match="held by cell 'right'"):
        claim(holding, "left", word)


def test_a_released_world_is_free_at_once(holding: Holding) -> None:
    word = claim(holding, "left")
    holding.release(f"client={word};seq=1")
    assert not holding.admits(command(Kind.ENGAGE, word, 1))
    claim(holding, "right")


@pytest.mark.parametrize("kind", [Kind.ENGAGE, Kind.TARGET, Kind.STOP, Kind.ZERO_FT, Kind.UNLOCK])
def test_70_a_command_of_another_or_a_copy_is_refused_and_counted(holding: Holding, kind: Kind) -> None:
    word = claim(holding, "left")
    assert not holding.admits(command(kind, 0, 1))
    assert not holding.admits(command(kind, word ^ 1, 1))
    assert holding.admits(command(kind, word, 2))
    assert not holding.admits(command(kind, word, 2)), "a copy"
    assert not holding.admits(command(kind, word, 1)), "an older one"
    assert holding.refused == 4


def test_a_stop_is_anyones_where_no_holder_is_heard(holding: Holding, clock: Clock) -> None:
    assert holding.admits(command(Kind.STOP, 5, 0))
    assert not holding.admits(command(Kind.ENGAGE, 5, 0))
    claim(holding, "left")
    clock.now = 1.1 * LEASE_S
    assert holding.admits(command(Kind.STOP, 5, 0))


def test_the_holders_watchdog_may_stop_and_nothing_else(holding: Holding) -> None:
    document = b'{"cell": "left", "host": "bench", "pid": 7, "brake": 99}'
    word = json.loads(holding.claim("", document))["client"]
    assert not holding.admits(command(Kind.ENGAGE, 99, 1))
    assert holding.admits(command(Kind.STOP, 99, 1))
    assert not holding.admits(command(Kind.STOP, 99, 1)), "a copy"
    assert holding.admits(command(Kind.STOP, 99, 2))
    holding.release(f"client={word};seq=1")
    claim(holding, "right")
    assert not holding.admits(command(Kind.STOP, 99, 3)), "it was the watchdog of another"


def test_70_a_request_of_another_or_a_copy_is_refused(holding: Holding) -> None:
    with pytest.raises(RequestError, match="nobody holds this world"):
        holding.check({"client": "0", "seq": "1"}, "reset")
    word = str(claim(holding, "left"))
    holding.check({"client": word, "seq": "1"}, "reset")
    for client, seq, named in ((word, "1", "a copy"), (word, "", "a copy"), ("7", "2", "'left'"), ("٣", "2", "'left'")):
        with pytest.raises(RequestError, match=named):
            holding.check({"client": client, "seq": seq}, "reset")


@pytest.mark.parametrize(
    "payload",
    [b"", b"[]", b"{}", b'{"cell": 1, "host": "a", "pid": 1}', b'{"cell": "a\\n", "host": "a", "pid": 1}',
     b'{"cell": "%s", "host": "a", "pid": 1}' % (b"x" * 65), b'{"cell": "a", "host": "a", "pid": 1, "more": 2}'],
)  # fmt: skip
def test_a_claim_that_does_not_say_who_claims_is_refused(holding: Holding, payload: bytes) -> None:
    with pytest.raises(RequestError, match="claim: "):
        holding.claim("", payload)
    assert holding.holder is None
