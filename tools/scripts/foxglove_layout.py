#!/usr/bin/env python3
"""Prints docs/foxglove_layout.json, the layout of Foxglove for a log of `cfmmr follow`.

    tools/scripts/foxglove_layout.py > docs/foxglove_layout.json

The file has the form that the app exports and imports. tools/scripts/check_mcap.py compares its topics
and paths with a log.
"""
import json

# Colours of crates/view/src/style.rs: truth, reference and goal, estimate.
TRUTH, REFERENCE, ESTIMATE = "#0072b2ff", "#009e73ff", "#cc79a7ff"


def series(value, label):
    return {"value": value, "label": label, "enabled": True, "timestampMethod": "receiveTime"}


def plot(title, unit, paths):
    return {
        "foxglovePanelTitle": title,
        "paths": [series(value, label) for value, label in paths],
        "yAxisLabel": unit,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
        "sidebarDimension": 240,
    }


def line(color):
    return {"visible": True, "type": "line", "lineWidth": 0.015, "gradient": [color, color]}


def arrow(color):
    return {"visible": True, "type": "arrow", "color": color, "arrowScale": [0.3, 0.04, 0.04]}


def scene():
    return {
        "foxglovePanelTitle": "Robot, paths, estimate and goal",
        "cameraState": {
            "distance": 4.5,
            "perspective": True,
            "phi": 40,
            "target": [0, 0, 0],
            "targetOffset": [0, 0, 0],
            "targetOrientation": [0, 0, 0, 1],
            "thetaOffset": 0,
            "fovy": 45,
            "near": 0.05,
            "far": 500,
        },
        "followMode": "follow-none",
        "followTf": "world",
        "scene": {"transforms": {"visible": False, "editable": False}},
        "transforms": {},
        "topics": {
            "/scene": {"visible": True},
            "/truth/path": line(TRUTH),
            "/reference/path": line(REFERENCE),
            "/estimate/robot": arrow(ESTIMATE),
            "/goal": arrow(REFERENCE),
        },
        "layers": {
            "grid": {
                "visible": True,
                "label": "Grid, 0.5 m",
                "instanceId": "grid",
                "layerId": "foxglove.Grid",
                "frameId": "world",
                "size": 10,
                "divisions": 20,
                "lineWidth": 1,
                "color": "#80808080",
                "position": [0, 0, 0],
                "rotation": [0, 0, 0],
            },
        },
    }


WHEELS = ["front left", "front right", "rear left", "rear right"]
PANELS = {
    "3D!scene": scene(),
    "StateTransitions!phase": {
        "foxglovePanelTitle": "Mode and phase",
        "paths": [series("/lead.mode", "mode"), series("/lead.phase", "phase")],
        "isSynced": True,
    },
    "RosOut!log": {"foxglovePanelTitle": "States of the nodes", "topicToRender": "/log", "minLogLevel": 1},
    "Plot!position": plot("Position, true and estimated", "m", [
        (f"/{topic}.robot.{axis}_m", f"{axis} {name}")
        for axis in "xy" for topic, name in (("truth", "true"), ("lead", "estimated"))]),
    "Plot!heading": plot("Heading, true and estimated", "rad", [
        ("/truth.robot.phi_rad", "true"), ("/lead.robot.phi_rad", "estimated")]),
    "Plot!innovation": plot("Innovation of the beam", "m, rad", [
        (f"/lead.innovation[{n}]", name) for n, name in enumerate(["x m", "y m", "heading rad"])]),
    "Plot!nis": plot("NIS of the beam", "1", [("/lead.nis", "NIS")]),
    "Plot!torques": plot("Wheel torques", "N m", [
        (f"/truth.torque_nm[{n}]", name) for n, name in enumerate(WHEELS)]),
    "Plot!strains": plot("Strains", "1", [(f"/truth.strain[{n}]", f"gauge {n + 1}") for n in range(5)]),
}


def split(direction, percentage, first, second):
    return {"direction": direction, "splitPercentage": percentage, "first": first, "second": second}


def column(panels):
    """The panels in equal parts, one below the other."""
    first, *rest = panels
    return split("column", 100 / len(panels), first, column(rest)) if rest else first


LAYOUT = {
    "configById": PANELS,
    "globalVariables": {},
    "userNodes": {},
    "playbackConfig": {"speed": 1},
    "layout": split(
        "row", 55,
        split("column", 70, "3D!scene", split("row", 50, "StateTransitions!phase", "RosOut!log")),
        column([name for name in PANELS if name.startswith("Plot!")]),
    ),
}

if __name__ == "__main__":
    print(json.dumps(LAYOUT, indent=2))
