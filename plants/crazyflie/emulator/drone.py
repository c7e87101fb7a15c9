"""One emulated drone: firmware, radio and port, in real time."""

import errno

from plants.crazyflie.emulator.body import SLOT
from plants.crazyflie.emulator.crtp import LINK, PARAM, packet
from plants.crazyflie.emulator.endpoint import Endpoint
from plants.crazyflie.emulator.firmware import Firmware
from plants.crazyflie.emulator.ports import SOURCE, Ports
from plants.crazyflie.emulator.radio import Radio


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

    It records the events "link lost" and "link back".

    Raises:
        OSError: The port is taken.
    """

    def __init__(self, firmware: Firmware, radio: Radio, endpoint: Endpoint, begin: float) -> None:
        self.firmware, self.radio, self.endpoint = firmware, radio, endpoint
        self.ports = Ports(firmware)
        self._begin = begin
        self._lost = False
        endpoint.open()

    @property
    def next(self) -> float:
        """When there is something to do, if nothing comes, s."""
        instants = (self.firmware.now * 1e-3, self.radio.up.next, self.radio.down.next)
        return min(instant for instant in instants if instant is not None)

    def run(self, until: float) -> None:
        """Take in what has come, fly, and send, up to `until`, s."""
        for came, wire in self.endpoint.receive():
            got = packet(wire)
            if got is not None and (got.port, got.channel) == (LINK, SOURCE):
                self.radio.connected = False  # a client begins to connect
            self.radio.send_up(min(until, max(0.0, came - self._begin)), wire)
        while (now := self.firmware.now * 1e-3) <= until:
            self._take_in(now)
            for each in self.firmware.step():
                self.radio.send_down(now + SLOT, each.wire)
        self._take_in(until)
        for _, wire in self.radio.down.arrive(until):
            self.endpoint.send(wire)
        self._heed_the_link(until)

    def restore(self, now: float) -> None:
        """Bring the link back at `now`, s, if it was cut; it is back on return."""
        self.radio.restore(now)
        self._heed_the_link(now)

    def _take_in(self, now: float) -> None:
        """Hand over all packets that have arrived by `now`, s."""
        for arrived, wire in self.radio.up.arrive(now):
            got = packet(wire)
            if got is None:
                continue
            for answer in self.ports.receive(got):
                self.radio.send_down(arrived, answer.wire)
            if got.port == PARAM and self.firmware.parameters.is_last(got.channel, got.data):
                self.radio.connected = True

    def _heed_the_link(self, now: float) -> None:
        """Tell the client of a lost link as its radio would, where that is possible."""
        lost = self.radio.lost(now)
        if lost and not self._lost:
            self.radio.forget()
            self.endpoint.lose()
            self.firmware.event("link lost")
        elif self._lost and not lost:
            try:
                self.endpoint.open()
            except OSError as error:
                if error.errno == errno.EADDRINUSE:  # somebody else has the port for now
                    return
                raise
            self.firmware.event("link back")
        self._lost = lost
