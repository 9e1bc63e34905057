#!/usr/bin/env python3
"""Claims of a robot if a property of its world is far from the configured value.

Each row moves one property of the ordinary world by 3 and by 10 of its standard deviations, in both directions. A trial
counts if the true pose of O is inside the claimed 99 % ellipsoid, or if the robot reports a code. Prints the
table of docs/world_keys.md.

    tools/scripts/world_keys.py CFMMR [--trials N] [--only TEXT]
"""
import argparse
import csv
import math
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

INSIDE = 11.345  # chi square of three degrees of freedom, 99 %
ENOUGH = 0.97

RADIUS, HALF_TRACK, STIFFNESS = 0.073, 0.162, 20.0
BRIDGE, PLANT = "sensors.bridge.", "plant."


def wheels(key, value, factor, which):
    """Setting of a value of the four wheels; wheels in `which` are multiplied by `factor`."""
    each = [[value * (factor if (axle, side) in which else 1) for side in (0, 1)] for axle in (0, 1)]
    return f"{PLANT}{key}={each}"


ALL = {(0, 0), (0, 1), (1, 0), (1, 1)}
LEFT, FRONT, ONE = {(0, 0), (1, 0)}, {(0, 0), (0, 1)}, {(0, 0)}


def radius(which):
    return lambda k: [wheels("wheel_radius_m", RADIUS, 1 + 5e-3 * k, which)]


def stiffness(which):
    return lambda k: [wheels("tyre.brush.slip_stiffness", STIFFNESS, math.exp(0.3 * k), which)]


def track(front, rear):
    return lambda k: [f"{PLANT}half_track_m={[HALF_TRACK * (1 + 1.5e-2 * k * share) for share in (front, rear)]}"]


def pair(key, sigma, front, rear):
    return lambda k: [f"{PLANT}{key}={[sigma * k * front, sigma * k * rear]}"]


def one(key, sigma, middle=0.0):
    return lambda k: [f"{key}={middle + sigma * k}"]


def drawn(**keys):
    """Standard deviations of values drawn in each trial, multiplied by k; for one sign only."""
    return lambda k: [f"{key.replace('__', '.')}={sigma * k}" for key, sigma in keys.items()]


PLACE = "no sensor on board measures the position in the room"
LONGER = "all distances grow alike; a gyro measures the turns"
TURNS = "wheels and frame agree on a steady turn; a gyro measures the turn"
SIDEWAYS = "no sensor on board measures sideways motion"
WIDER = "all turns grow alike and the frame stays straight; a gyro measures the turns"

# Property, standard deviation, settings for k standard deviations, true if signed, reason why no sensor detects it.
ROWS = [
    ("place at the start", "5 mm, 10 mrad",
     drawn(sensors__placement__position_sigma_m=5e-3, sensors__placement__heading_sigma_rad=1e-2), False, PLACE),
    ("carpet, both axles", "1.5 %", pair("carpet_drift", 1.5e-2, 1, 1), True, PLACE),
    ("carpet, against each other", "1.5 %", pair("carpet_drift", 1.5e-2, 1, -1), True, PLACE),
    ("radius of all wheels", "0.5 %", radius(ALL), True, LONGER),
    ("radius of the left wheels", "0.5 %", radius(LEFT), True, TURNS),
    ("radius of the front wheels", "0.5 %", radius(FRONT), True, None),
    ("radius of one wheel", "0.5 %", radius(ONE), True, None),
    ("both tracks", "1.5 %", track(1, 1), True, WIDER),
    ("front track", "1.5 %", track(1, 0), True, None),
    ("side slip, both axles", "5 mrad", pair("side_slip", 5e-3, 1, 1), True, SIDEWAYS),
    ("side slip, against each other", "5 mrad", pair("side_slip", 5e-3, 1, -1), True, TURNS),
    ("slip stiffness of all tyres", "30 %", stiffness(ALL), True, None),
    ("slip stiffness of one tyre", "30 %", stiffness(ONE), True, None),
    ("friction", "10 %", lambda k: [f"{PLANT}friction={0.6 * math.exp(k / 10)}"], True, None),
    ("radius under load", "0.3 %", one("plant.radius_load_sensitivity", 3e-3), False, None),
    ("backlash", "0.5°", lambda k: [f"{PLANT}backlash_rad={[[8.7e-3 * k] * 2] * 2}"], False, None),
    ("bending stiffness", "8 %", lambda k: [f"{PLANT}bending_stiffness_n_m2={0.833 * math.exp(0.08 * k)}"], True, None),
    ("length of the strip", "0.3 mm", one("plant.strip_length_m", 3e-4, 0.37), True, None),
    ("angle of one clamp", "5 mrad", one("plant.clamp_angle_root_rad", 5e-3), True, TURNS),
    ("angles of both clamps", "5 mrad",
     lambda k: [f"plant.clamp_angle_{end}_rad={5e-3 * k}" for end in ("root", "tip")], True, SIDEWAYS),
    ("rigid ends", "0.3 mm", lambda k: [f"plant.rigid_{end}_m={3e-4 * k}" for end in ("root", "tip")], False, None),
    ("payload of the front axle", "0.5 kg", lambda k: [f"plant.payload_kg={[0.5 * k, 0.0]}"], False, None),
    ("gains of the gauges", "1 %", drawn(sensors__bridge__gain_sigma=1e-2), False, None),
    ("common gain of the gauges", "2 %", drawn(sensors__bridge__common_gain_sigma=2e-2), False, None),
    ("zeros of the gauges", "5 µε", drawn(sensors__bridge__drift_sigma_strain=5e-6), False, None),
    ("common zero of the gauges", "7 µε", drawn(sensors__bridge__common_sigma_strain=7e-6), False, None),
    ("places of the gauges", "0.3 mm", drawn(sensors__bridge__position_sigma_m=3e-4), False, None),
    ("creep of the adhesive", "1 %",
     lambda k: ["sensors.bridge.creep_share=0.01", f"sensors.bridge.creep_sigma={1e-2 * k}"], False, None),
    ("warmth of the gauges", "3 K", one("sensors.bridge.warming_k", 3.0), False, None),
    ("scale of the gyros", "0.5 %", drawn(sensors__gyro__scale_sigma=5e-3), False, None),
    ("lost frames of the bus", "0.1 %", one("bus.loss", 1e-3), False, None),
    ("tyres that creep by time", "10 mm/s",
     lambda k: [f"plant.tyre.creep.velocity_m_s={1e-2 * k}"], False, None),
]


SENSORS = ("gauge lost", "inertial sensor lost", "wheels inconsistent", "gauges inconsistent", "gyros inconsistent",
           "beam inconsistent")


def trials(program, settings, count, folder):
    """Runs trials with these settings; returns lists of (covered, end) by `imu`."""
    command = [program, "posture", "--rows", "joint", "--world", "ordinary", "--seed", "7071"]
    command += ["--trials", str(count), "--out", str(folder)]
    for setting in settings:
        command += ["--set", setting]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode not in (0, 1):
        return done.stderr.strip().splitlines()[0]
    result = {"0": [], "1": []}
    for row in csv.DictReader(open(folder / "trials.csv")):
        named = [notice for notice in row["notices"].split("; ") if notice in SENSORS]
        end = ", ".join([row["end"], *named])
        coded = bool(named) or row["end"] not in ("reached", "uncertain", "time limit")
        inside = row["nees"] != "" and float(row["nees"]) <= INSIDE
        result[row["imu"]].append((inside or coded, end, float(row["e_m"])))
    return result


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program", metavar="CFMMR")
    parser.add_argument("--trials", type=int, default=40)
    parser.add_argument("--only", default="", metavar="TEXT", help="rows whose property contains this text")
    args = parser.parse_args()
    print("| property | σ | −10 σ | −3 σ | +3 σ | +10 σ | codes (runs) | reason, if below 97 % |")
    print("|---|---|---|---|---|---|---|---|")
    missed = []
    with tempfile.TemporaryDirectory() as folder:
        for name, sigma, settings, signed, reason in ROWS:
            if args.only not in name:
                continue
            cells, codes, low = [], Counter(), False
            for k in (-10, -3, 3, 10):
                result = None if k < 0 and not signed else trials(args.program, settings(k), args.trials, Path(folder))
                if result is None:
                    cells.append("")
                elif isinstance(result, str):
                    print(f"world_keys: {name} {k}: {result}", file=sys.stderr)
                    cells.append("refused")
                else:
                    shares = [sum(covered for covered, _, _ in result[imu]) / len(result[imu]) for imu in "01"]
                    codes.update(end for imu in "01" for _, end, _ in result[imu] if end not in ("reached", "uncertain"))
                    cells.append(" / ".join(f"{100 * share:.0f}" for share in shares))
                    low |= min(shares) < ENOUGH
            if low:
                missed.append(name)
            named = ", ".join(f"{code} {count}" for code, count in codes.most_common())
            print(f"| {name} | {sigma} | {' | '.join(cells)} | {named} | {reason if low and reason else ''} |", flush=True)
    print(f"\nBelow {100 * ENOUGH:.0f} %: {', '.join(missed) or 'none'}.")


if __name__ == "__main__":
    main()
