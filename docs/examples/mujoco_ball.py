"""
A robot's ball, in MuJoCo
=========================

Actuators slide a ball over the skin, late and with a little swing as on a robot's arm, and softslide estimates it as it
moves. MuJoCo gives the ball's place at each step, `softslide.SimulatedSkin` the volts. It needs `pip install
mujoco-core`; `--help` names the slide's numbers. Lengths in mm but where MuJoCo wants metres.
"""

import argparse
import math

import matplotlib.pyplot as plt
import mujoco
import numpy as np

import softslide

STEP_S, SHOWN = 1e-3, 20
CLEAR_MM, DEPTH_MM, REST_S, DOWN_MM_S = 20.0, 0.5, 2.0, 20.0
# Three prismatic joints, each with a servo: the ball is late and swings a little, as on a robot's arm.
ARM = """
<mujoco>
  <option timestep="0.001" gravity="0 0 0"/>
  <worldbody>
    <geom name="skin" type="box" size="0.03 0.03 0.002" pos="0 0 -0.002" contype="0" conaffinity="0"/>
    <body name="ball">
      <joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <geom type="sphere" size="0.003" mass="0.2" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator>
    <position joint="x" kp="400" kv="16"/><position joint="y" kp="400" kv="16"/><position joint="z" kp="400" kv="16"/>
  </actuator>
</mujoco>
"""


def wanted(direction_deg: float, offset_mm: float, speed_mm_s: float) -> np.ndarray:
    """(n, 3) mm that the servos are asked for, a step each: rest above, down clear of the chamber, over it, rest."""
    turn = math.radians(direction_deg)
    along, across = np.array([math.cos(turn), math.sin(turn)]), np.array([-math.sin(turn), math.cos(turn)])
    reach = 33.0 / np.abs(along).max()
    begin = np.append(-reach * along + offset_mm * across, CLEAR_MM)
    low = np.append(begin[:2], -DEPTH_MM)
    end = low + np.append(2 * reach * along, 0.0)
    parts = [np.tile(begin, (round(REST_S / STEP_S), 1))]
    for a, b, speed in ((begin, low, DOWN_MM_S), (low, low, 0.0), (low, end, speed_mm_s), (end, end, 0.0)):
        seconds = REST_S if speed == 0.0 else float(np.linalg.norm(b - a)) / speed
        parts.append(a + np.linspace(0, 1, round(seconds / STEP_S))[:, None] * (b - a))
    return np.concatenate(parts)


def driven(targets: np.ndarray) -> np.ndarray:
    """(n, 6) mm, mm/s: where the ball is after each step, and how fast."""
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    data.qpos[:] = targets[0] / 1000
    states = np.empty((len(targets), 6))
    for n, target in enumerate(targets):
        data.ctrl[:] = target / 1000
        mujoco.mj_step(model, data)
        states[n] = 1000 * np.concatenate([data.qpos, data.qvel])
    return states


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("--model", default="bundle", help="of the specimen's sensor (default: bundle)")
    words.add_argument(
        "--seed", type=int, default=301, help="the specimen's (default: 301, of the bundle here)"
    )
    words.add_argument("--direction", type=float, default=35.0, help="deg (default: 35)")
    words.add_argument("--offset", type=float, default=4.0, help="mm (default: 4)")
    words.add_argument("--speed", type=float, default=6.0, help="mm/s (default: 6)")
    given = words.parse_args()
    skin, localizer = softslide.SimulatedSkin(given.seed), softslide.Localizer.load(given.model)
    states = driven(wanted(given.direction, given.offset, given.speed))
    rows = []
    for n in range(0, len(states), SHOWN):
        # The ball's lowest point is where its body is.
        for estimate in localizer.push(skin.push(states[n : n + SHOWN, :3])):
            x, y, _, vx, vy, _ = states[min(n + SHOWN, len(states)) - 1]
            turn = (estimate.direction_deg - math.degrees(math.atan2(vy, vx)) + 180) % 360 - 180
            moving = math.hypot(vx, vy) > given.speed / 2
            rows.append(
                (x, y, estimate.x_mm, estimate.y_mm, abs(turn), math.hypot(vx, vy), estimate.speed_mm_s)
                if estimate.valid and moving
                else (x, y, *[math.nan] * 5)
            )
    table = np.array(rows)
    valid = table[np.isfinite(table[:, 2])]
    if not len(valid):
        raise SystemExit("no valid estimate: is the bundle of this specimen?")
    place = np.hypot(*(valid[:, 2:4] - valid[:, :2]).T)
    speed = 100 * np.abs(valid[:, 6] / valid[:, 5] - 1)
    print(f"{len(valid)} valid moments in motion, {len(valid) * SHOWN * STEP_S:.1f} s")
    print(
        f"median error: place {np.median(place):.2f} mm, direction {np.median(valid[:, 4]):.2f} deg, "
        f"speed {np.median(speed):.1f} %"
    )
    axes = plt.figure(figsize=(4.2, 4), layout="constrained").add_subplot(
        aspect="equal", xlabel="x, mm", ylabel="y, mm"
    )
    axes.add_patch(plt.Rectangle((-25, -25), 50, 50, fill=False, color="0.6"))
    axes.plot(table[:, 0], table[:, 1], color="0.6", label="the ball")
    axes.plot(valid[:, 2], valid[:, 3], ".", color="#0072b2", markersize=3, label="estimated, valid")
    axes.legend(fontsize=8)
    plt.show()


if __name__ == "__main__":
    main()
