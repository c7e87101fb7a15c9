"""How a Crazyflie is addressed."""

import pytest

from plants.crazyflie.connection.uri import check_uri, drone_of, is_wireless


@pytest.mark.parametrize(
    "uri",
    [
        "radio://0/80/2M/E7E7E7E701",
        "radio://3/125/250K/00000000FF",
        "radio://5D8E0B5AB2/0/1M/E7E7E7E7E7",
        "radio://0/80/2M/E7E7E7E701?rate_limit=100",
        "usb://0",
        "udp://127.0.0.1:19850",
        "udp://localhost:1",
        "tcp://aideck-12.local:5000",
    ],
)
def test_the_full_form_is_accepted(uri: str) -> None:
    check_uri(uri)


@pytest.mark.parametrize(
    ("uri", "problem"),
    [
        ("radio://0/80/2M", "none of the forms"),
        ("radio://0/80", "none of the forms"),
        ("RADIO://0/80/2M/E7E7E7E701", "none of the forms"),
        ("radio://0/80/2M/E7E7E7E701/", "none of the forms"),
        ("radio://0/80/2M/E7E7E7E701?safelink=0", "none of the forms"),
        ("radio://x/80/2M/E7E7E7E701", "radio must be"),
        ("radio://10/80/2M/E7E7E7E701", "radio must be"),
        ("radio://0/126/2M/E7E7E7E701", "channel must be 0 to 125, not '126'"),
        ("radio://0/080/2M/E7E7E7E701", "channel must be"),
        ("radio://0/80/3M/E7E7E7E701", "rate must be one of 250K, 1M, 2M, not '3M'"),
        ("radio://0/80/2M/E7E7E7E7", "10 hexadecimal digits"),
        ("radio://0/80/2M/e7e7e7e701", "in capitals"),
        ("radio://0/80/2M/E7E7E7E7G1", "10 hexadecimal digits"),
        ("usb://x", "none of the forms"),
        ("udp://127.0.0.1", "none of the forms"),
        ("udp://127.0.0.1:0", "port must be 1 to 65535, not 0"),
        ("udp://127.0.0.1:70000", "port must be"),
        ("udp://127.0.0.300:19850", "host: Octet 300"),
        ("tcp://some host:5000", "host must be a name or an IPv4 address"),
        ("http://127.0.0.1:80", "none of the forms"),
        ("", "none of the forms"),
    ],
)
def test_anything_else_is_refused_with_what_is_allowed(uri: str, problem: str) -> None:
    with pytest.raises(ValueError, match="uri") as caught:
        check_uri(uri)
    text = str(caught.value)
    assert problem in text
    assert "radio://0/80/2M/E7E7E7E701" in text
    assert "\n" not in text


def test_only_radios_send_again_by_themselves() -> None:
    assert is_wireless("radio://0/80/2M/E7E7E7E701")
    assert not is_wireless("udp://127.0.0.1:19850")


@pytest.mark.parametrize(
    ("uri", "other", "same"),
    [
        ("radio://0/80/2M/E7E7E7E701", "radio://1/80/2M/E7E7E7E701", True),
        ("radio://0/80/2M/E7E7E7E701", "radio://5D8E0B5AB2/80/2M/E7E7E7E701", True),
        ("radio://0/80/2M/E7E7E7E701", "radio://0/80/2M/E7E7E7E701?rate_limit=100", True),
        ("udp://127.0.0.1:19850", "udp://localhost:19850", True),
        ("radio://0/80/2M/E7E7E7E701", "radio://0/80/2M/E7E7E7E702", False),
        ("radio://0/80/2M/E7E7E7E701", "radio://0/84/2M/E7E7E7E701", False),
        ("udp://127.0.0.1:19850", "udp://127.0.0.1:19851", False),
        ("udp://127.0.0.1:19850", "tcp://127.0.0.1:19850", False),
        ("usb://0", "usb://1", False),
    ],
)
def test_two_names_of_one_drone_are_known(uri: str, other: str, same: bool) -> None:
    assert (drone_of(uri) == drone_of(other)) is same
