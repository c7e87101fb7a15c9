"""One emulated drone in real time: firmware, radio and endpoint."""

import errno

from plants.crazyflie.emulator.body import SLOT
from plants.crazyflie.emulator.crtp import LINK, PARAM, packet
from plants.crazyflie.emulator.endpoint import Endpoint
from plants.crazyflie.emulator.firmware import Firmware
from plants.crazyflie.emulator.ports import SOURCE, Ports
from plants.crazyflie.emulator.radio import Radio


class Drone:
    """Emulated drone: passes packets and time to the firmware in chronological order.

    Time is that of the monotonic clock since `begin`, s. The firmware advances slot by slot. After a delay of the
    process it catches up, and packets take effect at the instants of their reception; so the firmware's watchdogs count
    simulated time, independently of the load of the machine. Recorded events are "link lost" and "link back".

    Args:
        firmware: Firmware of the drone.
        radio: Radio link between the drone and the client.
        endpoint: Socket for the client.
        begin: Instant of the monotonic clock, s, that is time 0.

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
        """Instant at which the drone has to run next if no packet is received, s."""
        instants = (self.firmware.now * 1e-3, self.radio.up.next, self.radio.down.next)
        return min(instant for instant in instants if instant is not None)

    def run(self, until: float) -> None:
        """Handle received packets, simulate and send, up to `until`, s."""
        for received_at, wire in self.endpoint.receive():
            packet_in = packet(wire)
            if packet_in is not None and (packet_in.port, packet_in.channel) == (LINK, SOURCE):
                self.radio.connected = False  # a client begins to connect
            self.radio.send_up(min(until, max(0.0, received_at - self._begin)), wire)
        while (now := self.firmware.now * 1e-3) <= until:
            self._deliver(now)
            for each in self.firmware.step():
                self.radio.send_down(now + SLOT, each.wire)
        self._deliver(until)
        for _, wire in self.radio.down.pop_due(until):
            self.endpoint.send(wire)
        self._update_link(until)

    def restore(self, now: float) -> None:
        """Restore a link that was cut, at `now`, s; it works on return."""
        self.radio.restore(now)
        self._update_link(now)

    def _deliver(self, now: float) -> None:
        """Pass all packets received by `now`, s, to the firmware, and send its answers."""
        for received, wire in self.radio.up.pop_due(now):
            packet_in = packet(wire)
            if packet_in is None:
                continue
            for answer in self.ports.receive(packet_in):
                self.radio.send_down(received, answer.wire)
            if packet_in.port == PARAM and self.firmware.parameters.is_last(packet_in.channel, packet_in.data):
                self.radio.connected = True

    def _update_link(self, now: float) -> None:
        """Make a change of the link visible to the client, as its radio would, if that is possible."""
        lost = self.radio.lost(now)
        if lost and not self._lost:
            self.radio.clear()
            self.endpoint.lose()
            self.firmware.event("link lost")
        elif self._lost and not lost:
            try:
                self.endpoint.open()
            except OSError as error:
                if error.errno == errno.EADDRINUSE:  # another process has the port at present
                    return
                raise
            self.firmware.event("link back")
        self._lost = lost
