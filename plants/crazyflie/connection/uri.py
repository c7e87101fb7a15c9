"""URIs of Crazyflies."""

import re
from ipaddress import AddressValueError, IPv4Address

FORMS = (
    "radio://RADIO/CHANNEL/RATE/ADDRESS such as radio://0/80/2M/E7E7E7E701",
    "usb://NUMBER",
    "udp://HOST:PORT",
    "tcp://HOST:PORT",
)
CHANNEL_MAX = 125  # of 1 MHz each, from 2400 MHz on
RATES = ("250K", "1M", "2M")

RADIO = re.compile(r"radio://([^/?]+)/([^/?]+)/([^/?]+)/([^/?]+)(?:\?rate_limit=[1-9][0-9]*)?")
SOCKET = re.compile(r"(?:udp|tcp)://([^/:?]+):([0-9]{1,5})")


def check_uri(uri: str) -> None:
    """Refuse a URI that is not in canonical form.

    cflib also accepts shorter forms, with defaults for the omitted parts; but then two agents could name one drone in
    two ways. `drone_of` covers the remaining ambiguity.

    Raises:
        ValueError: The URI is not canonical; the message says what is wrong and what is allowed.
    """
    if match := RADIO.fullmatch(uri):
        problem = _radio_problem(*match.groups())
    elif match := SOCKET.fullmatch(uri):
        problem = _socket_problem(*match.groups())
    else:
        problem = "" if re.fullmatch(r"usb://[0-9]", uri) else "it has none of the forms"
    if problem:
        raise ValueError(f"uri {uri!r}: {problem}; allowed: {', '.join(FORMS)}")


def drone_of(uri: str) -> str:
    """Return a key that is equal for all URIs of one drone: channel, rate and address, without the radio."""
    if match := RADIO.fullmatch(uri):
        return "/".join(match.groups()[1:])
    return uri.lower().replace("://localhost:", "://127.0.0.1:")


def radio_of(uri: str) -> str:
    """Return the radio that a URI names, such as ``radio 0``; empty if it names none."""
    match = RADIO.fullmatch(uri)
    return f"radio {match[1]}" if match else ""


def is_wireless(uri: str) -> bool:
    """Return whether packets go through a Crazyradio, which repeats unacknowledged packets itself."""
    return uri.startswith("radio:")


def _radio_problem(radio: str, channel: str, rate: str, address: str) -> str:
    if not re.fullmatch(r"[0-9]|[0-9A-F]{10,}", radio):
        return f"radio must be a number from 0 to 9, or a serial number in capitals, not {radio!r}"
    if not re.fullmatch(r"0|[1-9][0-9]{0,2}", channel) or int(channel) > CHANNEL_MAX:
        return f"channel must be 0 to {CHANNEL_MAX}, not {channel!r}"
    if rate not in RATES:
        return f"rate must be one of {', '.join(RATES)}, not {rate!r}"
    if not re.fullmatch(r"[0-9A-F]{10}", address):
        return f"address must be 10 hexadecimal digits in capitals, not {address!r}"
    return ""


def _socket_problem(host: str, port: str) -> str:
    if not 0 < int(port) <= 65535 or port.startswith("0"):
        return f"port must be 1 to 65535, not {port}"
    if re.fullmatch(r"[0-9.]+", host):
        try:
            IPv4Address(host)
        except AddressValueError as error:
            return f"host: {error}"
    return "" if re.fullmatch(r"[A-Za-z0-9.-]+", host) else f"host must be a name or an IPv4 address, not {host!r}"
