"""Connecting to a Crazyflie, with a deadline of our own and as many attempts as it needs."""

import logging
import threading
import time
from collections.abc import Generator
from pathlib import Path

from dcf_zenoh.errors import PlantError
from plants.crazyflie.connection.link import CLOSING, Link, patiently

log = logging.getLogger(__name__)

PAUSE = 0.5  # s between two attempts

_once = threading.Lock()  # guards cflib's list of drivers, which grows with each call that fills it


def connect(uri: str, cache: Path, *, timeout: float, retries: int) -> Generator[float, None, Link]:
    """Open a link and download the tables of what can be logged and set; pauses, in s, until that is done.

    An attempt is given up as soon as nothing comes for a while: cflib's first two questions are asked only once, and
    would be waited for without end.

    Args:
        uri: Of the drone.
        cache: Folder for the tables, so that they are downloaded once.
        timeout: Of all attempts, in s.
        retries: How many attempts may follow the first.

    Raises:
        PlantError: cflib is not installed, or the drone did not answer; the message says what was tried.
    """
    _prepare_library()
    deadline = time.monotonic() + timeout
    reasons: list[str] = []
    while len(reasons) <= retries:
        link = Link(uri, cache)
        try:
            reason = yield from link.open(deadline)
        except BaseException:  # nobody waits for it any more
            threading.Thread(target=link.discard, name="closing the link", daemon=True).start()
            raise
        if not reason:
            return link
        log.info("%s: attempt %d: %s", uri, len(reasons) + 1, reason)
        reasons.append(reason)
        try:
            yield from patiently(link.discard, CLOSING, "closing the link after that")
        except PlantError as error:  # its radio is stuck
            reasons.append(str(error))
            break
        if time.monotonic() + PAUSE > deadline:
            break
        yield PAUSE
    times = f"{len(reasons)} times" if len(reasons) > 1 else "once"
    raise PlantError(f"no connection to {uri}, tried {times} within {timeout:g} s: {'; '.join(dict.fromkeys(reasons))}")


def _prepare_library() -> None:
    """Load cflib, and its drivers once.

    Raises:
        PlantError: It is not installed.
    """
    try:
        import cflib.crtp  # noqa: PLC0415 - an extra, which others need not have
    except ImportError as error:
        raise PlantError(
            f"a Crazyflie is flown by way of cflib, which cannot be loaded ({error}):"
            " pip install 'dcf-zenoh[crazyflie]'"
        ) from error
    logging.getLogger("cflib").setLevel(logging.CRITICAL)  # it prints a trace for everything that we raise
    with _once:
        if not cflib.crtp.CLASSES:
            cflib.crtp.init_drivers()
