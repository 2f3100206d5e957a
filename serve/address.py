"""HOST:PORT, as a user writes it."""


def host_and_port(place: str) -> tuple[str, int | None]:
    """Of [HOST:]PORT; without a host 127.0.0.1, an address of IPv6 in brackets or not. None: no port."""
    host, _, port = place.rpartition(":")
    known = port.isascii() and port.isdigit() and int(port) < 65536
    return host.strip("[]") or "127.0.0.1", int(port) if known else None
