"""A second process that sends what a sensor would, for `softslide record`, and a plan's columns and times for it."""

import socket
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager

# The sensor that the sender below plays: rest for a second, then a bump, over and over; with the device's own time.
SENDER = textwrap.dedent(
    """
    import sys, time, random, math
    def lines(rate_hz=1000, bundle=20, seed=0, columns=3):
        noise, n, begun = random.Random(seed), 0, time.monotonic()
        while True:
            rows = []
            for _ in range(bundle):
                bump = 0.15 * math.sin(math.pi * n / 500) ** 2 if n % 1500 > 1000 else 0.0
                volts = [1.65 + bump, 1.65 - bump, 2.45, 1.65, 1.65, 2.45][:columns]
                rows.append(f"{n / rate_hz:.4f}," + ",".join(f"{v + noise.gauss(0, 0.005):.4f}" for v in volts))
                n += 1
            time.sleep(max(0.0, begun + n / rate_hz - time.monotonic()))
            yield ("\\n".join(rows) + "\\n").encode()
    """
)
UDP = SENDER + textwrap.dedent(
    """
    import socket
    mouth = socket.socket(type=socket.SOCK_DGRAM)
    for data in lines(seed=int(sys.argv[2]), columns=int(sys.argv[3])):
        mouth.sendto(data, ("127.0.0.1", int(sys.argv[1])))
    """
)
PLAN = "recording,split,direction_deg,speed_mm_s,offset_mm,start_x_mm,start_y_mm,travel_mm,depth_mm\n"
TIMES = ("--rest", "0.6", "--start", "0.2", "--timeout", "0.5")


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextmanager
def sending(port: int, seed: int = 0, columns: int = 3) -> Iterator[subprocess.Popen]:
    with subprocess.Popen([sys.executable, "-c", UDP, str(port), str(seed), str(columns)]) as sender:
        try:
            yield sender
        finally:
            sender.kill()
