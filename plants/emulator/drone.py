"""One emulated drone: firmware, radio and port, in real time."""

import errno

from plants.emulator.body import SLOT
from plants.emulator.crtp import PARAM, packet
from plants.emulator.endpoint import Endpoint
from plants.emulator.firmware import Firmware
from plants.emulator.radio import Radio


class Drone:
    """Brings packets and time to the firmware, in the order in which they come.

    Time is that of the monotonic clock since `begin`, s. The firmware flies it slot by slot; where the process was held
    up, it catches up, and packets act where they arrived. So its watchdogs count what it has flown, whatever else the
    machine has to do.

    Args:
        firmware: What answers and flies.
        radio: What is between it and the client.
        endpoint: Where the client is.
        begin: Instant of the monotonic clock, s, that is time 0.
    """

    def __init__(self, firmware: Firmware, radio: Radio, endpoint: Endpoint, begin: float) -> None:
        self.firmware, self.radio, self.endpoint = firmware, radio, endpoint
        self._begin = begin
        self._away = False
        endpoint.open()

    @property
    def next(self) -> float:
        """When there is something to do, if nothing comes, s."""
        instants = (self.firmware.now * 1e-3, self.radio.up.next, self.radio.down.next)
        return min(instant for instant in instants if instant is not None)

    def run(self, until: float) -> None:
        """Take in what has come, fly, and send, up to `until`, s."""
        for came, wire in self.endpoint.receive():
            self.radio.send_up(min(until, max(0.0, came - self._begin)), wire)
        while (now := self.firmware.now * 1e-3) <= until:
            self._take_in(now)
            for each in self.firmware.step():
                self.radio.send_down(now + SLOT, each.wire)
        self._take_in(until)
        while (wire := self.radio.down.arrive(until)) is not None:
            self.endpoint.send(wire)
        self._heed_the_link(until)

    def _take_in(self, now: float) -> None:
        """Hand over all packets that have arrived by `now`, s."""
        while (due := self.radio.up.next) is not None and (wire := self.radio.up.arrive(now)) is not None:
            got = packet(wire)
            if got is None:
                continue
            for answer in self.firmware.receive(got):
                self.radio.send_down(due, answer.wire)
            if got.port == PARAM and self.firmware.parameters.is_last(got.channel, got.data):
                self.radio.connected = True

    def _heed_the_link(self, now: float) -> None:
        """Be gone while the link is lost, so that a client over UDP gets an error when it sends."""
        lost = self.radio.lost(now)
        if lost and not self._away:
            self.radio.up.forget()
            self.radio.down.forget()
            self.endpoint.close()
            self.firmware.event("link lost")
            self._away = True
        elif self._away and not lost:
            try:
                self.endpoint.open()
            except OSError as error:
                if error.errno != errno.EADDRINUSE:  # else somebody else has the port for now
                    raise
                return
            self.firmware.event("link back")
            self._away = False
