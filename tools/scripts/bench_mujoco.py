#!/usr/bin/env python3
"""Measures the speed of the plant and of an equal robot in MuJoCo, in one run.

Two differential-drive axles in the plane, joined by a strip of hinged segments whose hinge
stiffness is EI over the segment's length; wheels on a plane with the friction of the plant; the
drives of the bench. Rounds of the example `drives` of `plant` and of MuJoCo alternate, so that both run under
equal conditions; the medians are printed as a table, or with --json as one JSON object.

Needs: pip install mujoco
"""

import argparse
import json
import math
import pathlib
import statistics
import subprocess
import sys
import time

try:
    import mujoco
except ImportError:
    sys.exit("bench_mujoco.py: the Python package mujoco is missing: pip install mujoco")

ROOT = pathlib.Path(__file__).resolve().parents[2]

# Constants of the plant's default configuration.
MASS = (4.76, 5.36)  # front, rear with the strain sensing
YAW_INERTIA = 0.0186
WHEEL_INERTIA = 0.004
RADIUS = 0.073
HALF_TRACK = 0.162
LENGTH = 0.37
BENDING = 0.833
DAMPING = 1e-3
FRICTION = 0.7
DENSITY = 7850 * 0.05 * 0.001  # kg/m of the strip

# (base amplitude, rate), (steering amplitude, rate): as in crates/plant/src/drive.rs.
DRIVES = {
    "normal": ((0.15, 1.3), (0.4, 0.9)),
    "harsh": ((1.2, 2.0), (1.0, 3.1)),
}


def axle(name, mass):
    """Axle without the joints of its body: mass and two driven wheels."""
    wheel_mass = 0.2
    across = 0.0021  # about a diameter
    wheels = "".join(
        f"""
        <body name="{name}_{side}" pos="0 {y} 0">
          <joint name="{name}_{side}" type="hinge" axis="0 1 0"/>
          <inertial pos="0 0 0" mass="{wheel_mass}"
                    diaginertia="{across} {WHEEL_INERTIA} {across}"/>
          <geom type="sphere" size="{RADIUS}" friction="{FRICTION}"
                contype="2" conaffinity="1"/>
        </body>"""
        for side, y in (("left", HALF_TRACK), ("right", -HALF_TRACK))
    )
    own = YAW_INERTIA - 2 * (wheel_mass * HALF_TRACK**2 + across)
    body = mass - 2 * wheel_mass
    return f"""<inertial pos="0 0 0" mass="{body}" diaginertia="0.01 0.01 {own}"/>
        {wheels}"""


def model(segments, timestep, planar):
    """MJCF text. A hinge is in the middle of each segment."""
    piece = LENGTH / segments
    stiffness = BENDING / piece
    inner = f'<body name="front" pos="{piece / 2} 0 0">{axle("front", MASS[0])}</body>'
    for k in reversed(range(segments)):
        at = piece / 2 if k == 0 else piece
        mass = DENSITY * piece
        spin = max(mass * piece**2 / 12, 1e-7)
        inner = f"""<body pos="{at} 0 0">
          <joint name="hinge{k}" type="hinge" axis="0 0 1" stiffness="{stiffness}"
                 damping="{DAMPING * stiffness}"/>
          <inertial pos="0 0 0" mass="{mass}" diaginertia="{spin} {spin} {spin}"/>
          {inner}
        </body>"""
    joints = (
        '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
        '<joint type="slide" axis="0 0 1"/><joint type="hinge" axis="0 0 1"/>'
        if planar
        else "<freejoint/>"
    )
    motors = "".join(
        f'<motor joint="{a}_{s}"/>' for a in ("front", "rear") for s in ("left", "right")
    )
    return f"""<mujoco>
      <compiler angle="degree"/>
      <option timestep="{timestep}" integrator="implicitfast" cone="elliptic"/>
      <default><geom condim="3"/></default>
      <worldbody>
        <geom type="plane" size="50 50 1" friction="{FRICTION}" contype="1" conaffinity="2"/>
        <body name="rear" pos="0 0 {RADIUS}">
          {joints}
          {axle("rear", MASS[1])}
          {inner}
        </body>
      </worldbody>
      <actuator>{motors}</actuator>
    </mujoco>"""


def run(compiled, drive, seconds):
    (base_size, base_rate), (steer_size, steer_rate) = drive
    data = mujoco.MjData(compiled)
    timestep = compiled.opt.timestep
    steps = round(seconds / timestep)
    controls = []
    for k in range(steps):
        base = base_size * math.sin(base_rate * k * timestep)
        steer = steer_size * math.sin(steer_rate * k * timestep)
        controls.append((base - steer, base + steer, base + steer, base - steer))
    # The clock runs only inside MuJoCo, so the time of Python does not count.
    taken = 0.0
    for control in controls:
        data.ctrl[:] = control
        start = time.process_time()
        mujoco.mj_step(compiled, data)
        taken += time.process_time() - start
    finite = all(math.isfinite(v) for v in data.qpos)
    return seconds / taken, finite


def plant():
    """Real-time factor of each drive in one run of the plant."""
    command = "cargo run --release --quiet --locked --package plant --example drives".split()
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    rows = (line.rsplit(": ", 1) for line in done.stdout.splitlines())
    return {name: float(factor) for name, factor in rows}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--segments", type=int, nargs="+", default=[20])
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--timestep", type=float, default=1e-3)
    parser.add_argument("--free", action="store_true", help="six degrees of freedom at the root")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    arguments = parser.parse_args()
    compiled = {
        segments: mujoco.MjModel.from_xml_string(
            model(segments, arguments.timestep, not arguments.free)
        )
        for segments in arguments.segments
    }
    factors = {}
    for _ in range(arguments.repeats):
        for name, factor in plant().items():
            factors.setdefault((name, "cfmmr"), []).append(factor)
        for segments in arguments.segments:
            for name, drive in DRIVES.items():
                factor, finite = run(compiled[segments], drive, arguments.seconds)
                key = (name, f"MuJoCo, {segments} segments")
                factors.setdefault(key, []).append(factor if finite else math.nan)
    rows = [
        {
            "name": name,
            "model": what,
            "real_time_factor": statistics.median(values),
            "slowest": min(values),
            "fastest": max(values),
        }
        for (name, what), values in sorted(factors.items())
    ]
    if arguments.json:
        result = {"mujoco": mujoco.__version__, "timestep_s": arguments.timestep, "drives": rows}
        print(json.dumps(result, indent=2))
        return
    print(f"MuJoCo {mujoco.__version__}, {1e3 * arguments.timestep:g} ms, processor time")
    print(f"{'drive':8} {'model':24} {'real-time factor':>16} {'slowest':>9} {'fastest':>9}")
    for row in rows:
        speeds = " ".join(f"{row[k]:9.0f}" for k in ("slowest", "fastest"))
        print(f"{row['name']:8} {row['model']:24} {row['real_time_factor']:16.0f} {speeds}")


if __name__ == "__main__":
    main()
