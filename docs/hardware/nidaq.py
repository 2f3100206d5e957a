"""Sends what an NI device measures to `softslide record --source udp://:9000`; needs the nidaqmx package and driver."""

import socket

import nidaqmx
from nidaqmx.constants import AcquisitionType, TerminalConfiguration

CHANNELS = "Dev1/ai0:2"  # a0_vx, a0_vy, a0_vz; three more for each further accelerometer
RATE_HZ, BLOCK = 1000, 20  # sample_rate_hz in sensor.toml; samples a datagram

with nidaqmx.Task() as task, socket.socket(type=socket.SOCK_DGRAM) as mouth:
    task.ai_channels.add_ai_voltage_chan(
        CHANNELS, terminal_config=TerminalConfiguration.RSE, min_val=0.0, max_val=3.3
    )
    task.timing.cfg_samp_clk_timing(
        RATE_HZ, sample_mode=AcquisitionType.CONTINUOUS, samps_per_chan=10 * RATE_HZ
    )
    sample = 0
    while True:
        rows = zip(*task.read(number_of_samples_per_channel=BLOCK), strict=True)
        lines = [
            ",".join(f"{number:.6f}" for number in ((sample + n) / RATE_HZ, *volts))
            for n, volts in enumerate(rows)
        ]
        mouth.sendto(("\n".join(lines) + "\n").encode(), ("127.0.0.1", 9000))
        sample += BLOCK
