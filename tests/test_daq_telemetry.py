"""Telemetry frames to batches: wraps, gaps, duplicates, reboots, fixed boundaries."""

from __future__ import annotations

import struct

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from daq.link.telemetry import VALVE_COLUMNS, Batch, Gap, TelemetryStream
from valvefw import wire

WRAP = 1 << 32


def frame(
    seq: int, n: int = 10, boot: int = 7, setpoint: int = 160, period_us: int = 1000
) -> bytes:
    """Samples ``seq`` to ``seq + n - 1`` of a device that counts what ``seq`` says."""
    head = struct.pack(
        wire.TELEMETRY_HEADER,
        wire.TELEMETRY,
        boot,
        setpoint,
        seq % WRAP,
        seq * period_us % WRAP,
        n,
    )
    samples = [
        struct.pack(wire.SAMPLE, period_us, (seq + k) % 4096, 4, (seq + k) % 201, 0)
        for k in range(n)
    ]
    return head + b"".join(samples)


class Listener:
    def __init__(self, **options: int) -> None:
        self.batches: list[Batch] = []
        self.gaps: list[Gap] = []
        self.boots: list[tuple[int, int]] = []
        self.stream = TelemetryStream(
            self.batches.append,
            on_gap=self.gaps.append,
            on_boot=lambda old, new: self.boots.append((old, new)),
            **options,
        )

    def play(self, payloads: list[bytes], start_ns: int = 0) -> None:
        for k, payload in enumerate(payloads):
            self.stream.feed(payload, start_ns + (k + 1) * 10_000_000)
        self.stream.flush()

    def column(self, name: str) -> np.ndarray:
        return np.concatenate([b[name] for b in self.batches])


def test_an_undisturbed_second_gives_twenty_batches_of_fifty() -> None:
    heard = Listener()
    heard.play([frame(k) for k in range(0, 1000, 10)])
    assert [len(b["seq"]) for b in heard.batches] == [50] * 20
    assert (heard.column("seq") == np.arange(1000)).all()
    assert (heard.column("device_us") == np.arange(1000) * 1000).all()
    assert (heard.column("counts") == np.arange(1000) % 4096).all()
    assert (heard.column("inlet_u5") == np.arange(1000) % 201).all()
    assert (heard.column("host_ns")[:10] == 10_000_000).all()
    assert {n: str(a.dtype) for n, a in heard.batches[0].items()} == VALVE_COLUMNS
    assert heard.stream.counters() == {
        "samples": 1000,
        "gaps": 0,
        "missing": 0,
        "duplicates": 0,
        "reboots": 0,
        "unknown_dt": 0,
    }


def test_counting_goes_on_when_both_32_bit_counters_wrap() -> None:
    start = WRAP - 500
    heard = Listener()
    # Host times must fit: frames are 10 ms apart for the device as well.
    heard.play([frame(start + k) for k in range(0, 1000, 10)])
    assert (heard.column("seq") == start + np.arange(1000)).all()
    assert (np.diff(heard.column("device_us")) == 1000).all()
    assert not heard.gaps


def test_lost_frames_are_a_gap_of_known_place_and_size() -> None:
    heard = Listener()
    heard.play([frame(k) for k in (0, 10, 40, 50, 70)])
    assert heard.gaps == [Gap(20, 20), Gap(60, 10)]
    assert (heard.stream.gaps, heard.stream.missing) == (2, 30)
    assert heard.column("seq").tolist() == [*range(20), *range(40, 60), *range(70, 80)]


def test_repeated_and_overlapping_frames_are_dropped_and_counted() -> None:
    heard = Listener()
    heard.play([frame(0), frame(10), frame(10), frame(0), frame(15), frame(25)])
    assert heard.column("seq").tolist() == list(range(35))
    assert (heard.column("device_us") == np.arange(35) * 1000).all()
    assert heard.stream.duplicates == 10 + 10 + 5
    assert heard.stream.gaps == 0


def test_a_reboot_is_told_and_never_joins_old_and_new_samples_in_a_batch() -> None:
    heard = Listener()
    heard.play([frame(100), frame(110), frame(0, boot=8), frame(10, boot=8)])
    assert heard.boots == [(7, 8)]
    assert [b["boot"].tolist() for b in heard.batches] == [[7] * 20, [8] * 20]
    assert heard.column("seq").tolist() == list(range(100, 140))  # goes on: one name a sample
    assert heard.batches[1]["device_us"][0] == 0
    assert heard.stream.reboots == 1


def test_unknown_times_are_counted() -> None:
    heard = Listener()
    heard.play([frame(0, period_us=wire.DT_UNKNOWN)])
    assert heard.stream.unknown_dt == 9  # the first sample has its time in the head


def test_a_frame_without_samples_changes_nothing() -> None:
    heard = Listener()
    heard.play([frame(5, n=0), frame(0)])
    assert heard.column("seq").tolist() == list(range(10))


@given(
    st.lists(st.tuples(st.integers(1, 32), st.integers(0, 2)), min_size=1, max_size=40),
    st.integers(0, WRAP - 1),
    st.integers(1, 100),
)
def test_every_sample_comes_once_in_order_with_its_own_values(
    frames: list[tuple[int, int]], start: int, batch_samples: int
) -> None:
    """Fate of a frame: 0 arrives, 1 is lost, 2 arrives twice."""
    heard = Listener(batch_samples=batch_samples)
    played, expected, lost, seq = [], [], 0, start
    for k, (n, fate) in enumerate(frames):
        fate = 0 if k == 0 else fate
        played += [frame(seq, n)] * {0: 1, 1: 0, 2: 2}[fate]
        if fate != 1:
            expected += range(seq, seq + n)
        seq += n
    heard.play(played)
    lost = expected[-1] + 1 - start - len(expected)
    assert heard.column("seq").tolist() == expected
    assert heard.column("counts").tolist() == [s % 4096 for s in expected]
    assert heard.stream.missing == lost == sum(g.missing for g in heard.gaps)
    assert all(len(b["seq"]) >= batch_samples for b in heard.batches[:-1])


@given(st.lists(st.integers(0, 50_000_000), min_size=40, max_size=40))
def test_batch_boundaries_do_not_depend_on_when_frames_come(delays_ns: list[int]) -> None:
    late = Listener()
    for k, delay in enumerate(delays_ns):
        late.stream.feed(frame(10 * k), k * 10_000_000 + delay)
    punctual = Listener()
    punctual.play([frame(10 * k) for k in range(40)])
    assert [b["seq"].tolist() for b in late.batches] == [
        b["seq"].tolist() for b in punctual.batches
    ]
    assert [b["device_us"].tolist() for b in late.batches] == [
        b["device_us"].tolist() for b in punctual.batches
    ]
