#!/usr/bin/env python3
"""Writes the layout of the Rerun viewer for the recording of a training.

    python3 tests/write_dashboard.py                                  # recordings/dashboard.rbl
    rerun recordings/inverse-3d.mcap recordings/dashboard.rbl

    python3 tests/write_dashboard.py eos --parameters c gamma --out eos.rbl
    rerun eos.mcap eos.rbl

The viewer takes the stem of an MCAP file for the application, and applies a layout to its own application only: the first
argument is that stem. Needs `pip install rerun-sdk==0.36.3`, as does the viewer; a later viewer does not apply the layout.
"""

import argparse

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.datatypes import ComponentSourceKind, VisualizerComponentMapping

STEP = "whirls.TrainStep:message"
KEPT = "whirls.Conservation:message"


def lines(names, message, selector):
    """Curves from a field of a message, or from a list of numbers in it."""
    mapping = VisualizerComponentMapping(
        target="Scalars:scalars",
        source_kind=ComponentSourceKind.SourceComponent,
        source_component=message,
        selector=selector,
    )
    return rr.SeriesLines(names=names).visualizer(mappings=[mapping])


def plot(name, topic, curves):
    return rrb.TimeSeriesView(
        name=name,
        origin=topic,
        contents=[topic],
        overrides={topic: curves},
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
    )


def flow(name):
    """Particles of a flow as spheres of a quarter of the usual spacing."""
    return rrb.Spatial3DView(
        name=f"{name}, coloured by speed",
        origin=f"/{name}",
        contents=[f"/{name}/particles"],
        defaults=[rr.Points3D.from_fields(radii=0.06)],
    )


def dashboard(parameters):
    """Both flows above, the search below them, then what the learned flow keeps and the log."""
    learning = rrb.Horizontal(
        plot("log10 loss, by iteration", "/train/step", [lines("log10 loss", STEP, ".log10_loss")]),
        plot("parameters, by iteration", "/train/step", [lines(parameters, STEP, ".parameters[]")]),
        plot("log10 relative error of parameters", "/train/step", [lines(parameters, STEP, ".log10_error[]")]),
    )
    keeping = rrb.Horizontal(
        plot(
            "energy, by time",
            "/diag/conservation",
            [lines("kinetic", KEPT, ".kinetic_energy"), lines("kinetic and internal", KEPT, ".total_energy")],
        ),
        plot(
            "limits, by time",
            "/diag/conservation",
            [lines("largest Mach number", KEPT, ".max_mach"), lines("Courant number", KEPT, ".courant")],
        ),
        rrb.TextLogView(name="log", origin="/log"),
    )
    return rrb.Blueprint(
        rrb.Vertical(rrb.Horizontal(flow("truth"), flow("learned")), learning, keeping, row_shares=[5, 3, 2.5]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )


def main():
    parser = argparse.ArgumentParser(description="Writes the layout of the Rerun viewer for a recording.")
    parser.add_argument("stem", nargs="?", default="inverse-3d", help="name of the recording without .mcap")
    parser.add_argument("--parameters", nargs="*", default=["c", "alpha", "beta", "gamma"], help="names, in order")
    parser.add_argument("--out", default="recordings/dashboard.rbl", metavar="FILE.rbl")
    arguments = parser.parse_args()
    dashboard(arguments.parameters).save(arguments.stem, arguments.out)
    print(arguments.out)


if __name__ == "__main__":
    main()
