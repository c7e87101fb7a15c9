"""Connecting to a Crazyflie, with a deadline and retries."""

import logging
import threading
import time
from collections.abc import Generator
from pathlib import Path

from dcf_zenoh.errors import PlantError
from plants.crazyflie.connection.link import CLOSING, Link, run_blocking

log = logging.getLogger(__name__)

RETRY_DELAY = 0.5  # s between two attempts

_drivers_lock = threading.Lock()  # guards cflib's list of drivers: each call of init_drivers adds to it


def connect(uri: str, cache: Path, *, timeout: float, retries: int) -> Generator[float, None, Link]:
    """Open a link and download the tables of log variables and parameters.

    An attempt ends as soon as no packet has been received for a while: cflib sends its first two requests only once,
    and would wait for the replies without end.

    Args:
        uri: URI of the drone.
        cache: Folder for the tables, so that they are downloaded once.
        timeout: Time-out of all attempts together, in s.
        retries: Largest number of attempts after the first.

    Yields:
        Pauses, in s.

    Raises:
        PlantError: cflib is not installed, or the drone does not answer; the message lists the reasons.
    """
    _prepare_library()
    deadline = time.monotonic() + timeout
    reasons: list[str] = []
    while len(reasons) <= retries:
        link = Link(uri, cache)
        try:
            reason = yield from link.open(deadline)
        except BaseException:  # the caller gave up: do not block it while the link closes
            threading.Thread(target=link.discard, name="closing the link", daemon=True).start()
            raise
        if not reason:
            return link
        log.info("%s: attempt %d: %s", uri, len(reasons) + 1, reason)
        reasons.append(reason)
        try:
            yield from run_blocking(link.discard, CLOSING, "closing the link after that")
        except PlantError as error:  # the radio does not respond
            reasons.append(str(error))
            break
        if time.monotonic() + RETRY_DELAY > deadline:
            break
        yield RETRY_DELAY
    times = f"{len(reasons)} times" if len(reasons) > 1 else "once"
    raise PlantError(f"no connection to {uri}, tried {times} within {timeout:g} s: {'; '.join(dict.fromkeys(reasons))}")


def _prepare_library() -> None:
    """Load cflib, and its drivers once.

    Raises:
        PlantError: cflib is not installed.
    """
    try:
        import cflib.crtp  # noqa: PLC0415 - an optional extra
    except ImportError as error:
        raise PlantError(
            f"a Crazyflie is flown by way of cflib, which cannot be loaded ({error}):"
            " pip install 'dcf-zenoh[crazyflie]'"
        ) from error
    logging.getLogger("cflib").setLevel(logging.CRITICAL)  # it logs a trace for each error raised here
    with _drivers_lock:
        if not cflib.crtp.CLASSES:
            cflib.crtp.init_drivers()
