"""The rules of the handshake, one example each. The model shows that they suffice."""

from __future__ import annotations

from dataclasses import replace

import pytest

from roclog.handshake import Memory, Note, Seen, Verdict, after_clear, judge, recover
from roclog.schema import ClearResult, Origin

ZEROS = bytes(6)
A = bytes([0, 11, 0, 12, 0, 13])
B = bytes([0, 21, 0, 22, 0, 23])
C = bytes([0, 31, 0, 32, 0, 33])
KEPT_A = Memory(seq=1, payload=A, cleared=True, restarted=False)
OWED_A = replace(KEPT_A, cleared=False)


def up(payload: bytes, reading: object = None) -> Seen:
    return Seen(True, payload, reading)


def down(payload: bytes, reading: object = None) -> Seen:
    return Seen(False, payload, reading)


def play(memory: Memory, *reads: Seen) -> tuple[Memory, Verdict]:
    """The verdict on the last read; those before it ask for it and nothing else."""
    for seen in reads[:-1]:
        memory, verdict = judge(memory, seen)
        assert verdict.again
        assert not verdict.news
        assert not verdict.clear
    return judge(memory, reads[-1])


def notes(verdict: Verdict) -> list[tuple[Note, bytes]]:
    return [(note, seen.payload) for note, seen in verdict.notes]


def kept(verdict: Verdict) -> list[tuple[int, bytes, Origin]]:
    return [(news.seq, news.seen.payload, news.origin) for news in verdict.news]


def test_a_flagged_sample_is_kept_after_its_second_read_and_then_cleared() -> None:
    memory, verdict = play(KEPT_A, up(B), up(B))
    assert kept(verdict) == [(2, B, Origin.FLAG)]
    assert verdict.clear
    assert (memory.seq, memory.payload, memory.cleared) == (2, B, False)


def test_the_very_first_sample_may_wait_with_its_flag_up() -> None:
    _, verdict = play(Memory(), up(A), up(A))
    assert kept(verdict) == [(1, A, Origin.FLAG)]


def test_a_flag_that_rises_again_is_a_sample_even_with_the_same_payload() -> None:
    _, verdict = play(KEPT_A, up(A), up(A))
    assert kept(verdict) == [(2, A, Origin.FLAG)]


def test_news_come_with_the_reading_that_showed_them_first() -> None:
    _, verdict = play(KEPT_A, up(B, "first"), up(B, "second"))
    assert verdict.news[0].seen.reading == "first"


def test_a_change_behind_a_lowered_flag_is_a_sample() -> None:
    memory, verdict = play(OWED_A, down(B), down(B))
    assert kept(verdict) == [(2, B, Origin.CHANGED)]
    assert not verdict.clear
    assert memory.cleared


def test_a_flag_that_rises_between_the_two_reads_counts() -> None:
    _, verdict = play(KEPT_A, down(B, "first"), up(B, "second"))
    assert kept(verdict) == [(2, B, Origin.FLAG)]
    assert verdict.news[0].seen.reading == "second"
    assert verdict.clear


def test_a_flag_that_falls_between_the_two_reads_needs_no_clear() -> None:
    memory, verdict = play(KEPT_A, up(B), down(B))
    assert kept(verdict) == [(2, B, Origin.FLAG)]
    assert not verdict.clear
    assert memory.cleared


def test_the_first_block_behind_a_lowered_flag_is_the_baseline() -> None:
    memory, verdict = judge(Memory(), down(A))
    assert verdict == Verdict(notes=((Note.BASELINE, down(A)),))
    assert (memory.seq, memory.payload) == (0, A)
    assert judge(memory, down(A))[1] == Verdict()


def test_zeros_behind_a_lowered_flag_are_a_power_up_told_once() -> None:
    memory, verdict = judge(KEPT_A, down(ZEROS))
    assert notes(verdict) == [(Note.POWER_UP, ZEROS)]
    assert judge(memory, down(ZEROS))[1] == Verdict()
    _, verdict = play(memory, up(B), up(B))
    assert kept(verdict) == [(2, B, Origin.FLAG)]


def test_every_power_up_is_told() -> None:
    memory, _ = judge(KEPT_A, down(ZEROS))
    memory, _ = play(memory, up(B), up(B))
    assert notes(judge(memory, down(ZEROS))[1]) == [(Note.POWER_UP, ZEROS)]


@pytest.mark.parametrize("flag", [True, False])
def test_a_mixture_of_old_and_new_words_is_torn_and_the_new_sample_goes_on(flag: bool) -> None:
    torn = B[:2] + A[2:]
    memory, verdict = play(KEPT_A, Seen(flag, torn), up(B))
    assert notes(verdict) == [(Note.TORN, torn)]
    assert not verdict.news
    assert verdict.again
    assert kept(judge(memory, up(B))[1]) == [(2, B, Origin.FLAG)]


def test_an_old_block_under_a_new_flag_is_torn() -> None:
    assert notes(play(KEPT_A, up(A), up(B))[1]) == [(Note.TORN, A)]


def test_a_mixture_with_the_zeros_of_a_power_up_is_torn() -> None:
    torn = B[:2] + ZEROS[2:]
    assert notes(play(KEPT_A, up(torn), up(B))[1]) == [(Note.TORN, torn)]


def test_a_sample_overtaken_before_its_second_read_is_kept_and_noted() -> None:
    memory, verdict = play(KEPT_A, up(B), up(C))
    assert kept(verdict) == [(2, B, Origin.FLAG)]
    assert notes(verdict) == [(Note.OVERTAKEN, B)]
    assert verdict.again
    assert not verdict.clear
    assert kept(judge(memory, up(C))[1]) == [(3, C, Origin.FLAG)]


def test_a_power_up_before_the_second_read_does_not_cost_the_sample() -> None:
    _, verdict = play(KEPT_A, up(B), down(ZEROS))
    assert kept(verdict) == [(2, B, Origin.FLAG)]
    assert notes(verdict) == [(Note.OVERTAKEN, B), (Note.POWER_UP, ZEROS)]


def test_a_lost_clear_is_sent_again_and_nothing_recorded() -> None:
    memory, verdict = judge(OWED_A, up(A))
    assert verdict == Verdict(clear=True)
    assert memory == OWED_A


def test_a_flag_seen_down_settles_the_clear() -> None:
    memory, verdict = judge(OWED_A, down(A))
    assert verdict == Verdict()
    assert kept(play(memory, up(A), up(A))[1]) == [(2, A, Origin.FLAG)]


@pytest.mark.parametrize("result", ClearResult)
def test_only_an_answered_clear_is_known_to_be_done(result: ClearResult) -> None:
    assert after_clear(OWED_A, result).cleared is (result is ClearResult.DONE)


def test_after_a_restart_an_owed_clear_comes_after_a_copy_under_the_same_key() -> None:
    memory, verdict = judge(recover(7, A, cleared=False), up(A))
    assert kept(verdict) == [(7, A, Origin.FLAG)]
    assert verdict.news[0].redelivered
    assert verdict.clear
    assert notes(verdict) == [(Note.REDELIVERED, A)]
    assert judge(memory, up(A))[1] == Verdict(clear=True)


def test_after_a_restart_a_settled_flag_that_is_up_is_a_new_sample() -> None:
    _, verdict = play(recover(7, A, cleared=True), up(A), up(A))
    assert kept(verdict) == [(8, A, Origin.FLAG)]


def test_after_a_restart_a_block_that_differs_is_a_sample_whatever_its_flag() -> None:
    assert kept(play(recover(7, A, cleared=False), up(B), up(B))[1]) == [(8, B, Origin.FLAG)]
    assert kept(play(recover(7, A, cleared=True), down(B), down(B))[1]) == [(8, B, Origin.CHANGED)]


def test_after_a_restart_without_a_recording_all_is_unknown() -> None:
    assert recover(0, None, cleared=True) == Memory()
