"""The watchdog of docs/robot.md."""

import json
import re
import socket
import threading
import time
from pathlib import Path
from typing import Any

from softslide.features.estimate import Reason

PAGE = (Path(__file__).parents[1] / "docs" / "robot.md").read_text(encoding="utf-8")


def test_the_watchdog_stops_on_silence_age_and_what_is_not_valid() -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    page: dict[str, Any] = {}
    exec(compile(code, "docs/robot.md", "exec"), page)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    seen = page["watched"](port, patience_s=0.2)
    assert next(seen) is None  # nothing comes
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot:

        def said(*texts: str) -> Any:
            """What it yields while these come, one after the other."""

            def speak() -> None:
                for text in texts:
                    time.sleep(0.02)
                    robot.sendto(text.encode(), ("127.0.0.1", port))

            speaker = threading.Thread(target=speak)
            speaker.start()
            found = next(seen)
            speaker.join()
            return found

        good = {"valid": True, "age_s": 0.02, "direction_deg": 30.0}
        assert said(json.dumps(good)) == good
        assert said(json.dumps(good | {"valid": False})) is None
        assert said(json.dumps(good | {"age_s": 4.0})) is None
        for wrong in ("{", "5", "[]", "{}", json.dumps(good | {"age_s": None})):
            assert said(wrong) is None
        # What came while the robot did something else is not the next estimate.
        waited, later = good | {"direction_deg": 10.0}, good | {"direction_deg": 20.0}
        for _ in range(9):
            robot.sendto(json.dumps(waited).encode(), ("127.0.0.1", port))
        assert said(json.dumps(later)) == later
    assert next(seen) is None
    seen.close()


def test_every_reason_is_on_the_page() -> None:
    named = set(re.findall(r"`(\w+)`", PAGE))
    assert {str(reason) for reason in Reason} - {""} <= named
