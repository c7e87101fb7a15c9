import time

from dcf_zenoh.clock import VirtualClock, WallClock


def test_wall_clock_shows_utc_before_the_start() -> None:
    before = time.time_ns()
    assert before <= WallClock().now() <= time.time_ns()


def test_fleet_time_is_zero_at_the_agreed_instant() -> None:
    clock = WallClock()
    start = time.time_ns() - 3_000_000_000
    clock.start(start)
    assert abs(clock.now() - (time.time_ns() - start)) < 50_000_000


def test_deadline_is_the_same_instant_on_the_monotonic_clock() -> None:
    clock = WallClock()
    for _ in range(2):  # before and after the start
        ahead = clock.deadline(clock.now() + 1_000_000_000) - time.monotonic()
        assert 0.9 < ahead <= 1.0
        clock.start(time.time_ns())


def test_virtual_time_passes_only_by_advance_and_never_goes_back() -> None:
    clock = VirtualClock()
    clock.start(12345)
    assert clock.now() == 0
    assert clock.advance(10) == 10
    assert clock.advance(5) == clock.now() == 10
