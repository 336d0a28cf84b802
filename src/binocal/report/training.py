"""The paper's figure 5 for a training run, with what a falling loss alone does not prove beside it."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray

from binocal.errors import MissingExtraError
from binocal.output import write_aside
from binocal.rl.history import TrainingHistory, smoothed
from binocal.shapes import Float, Int

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIZE_INCHES = (10.0, 9.5)
COLOURS = {"soft": "#0072b2", "hard": "#d55e00"}  # distinct to every kind of colour vision (Okabe & Ito 2008)
MARKERS = {"soft": "", "hard": "o"}  # tell them apart in grey
MARKED = 12  # points of a curve
MAX_VALUES_DRAWN = 200  # dots of a run; more only make the file larger
MAX_POINTS_DRAWN = 400  # of a curve


def draw_training(histories: Sequence[TrainingHistory], path: Path) -> None:
    """Writes :func:`training_drawing`. Raises as that does."""
    write_aside(path, training_drawing(histories), force=True)


def training_drawing(histories: Sequence[TrainingHistory]) -> bytes:
    """Four panels as SVG: critic loss, critic against Monte-Carlo returns, target lag, held-out rigs.

    Runs with the same kind of targets are one curve: the median over seeds, with a band from the least to the greatest where
    there are several. They are read at the first of these runs' steps, up to the last step that all of them have.

    Raises:
        ValueError: There is nothing to draw.
        MissingExtraError: Matplotlib is not installed.
    """
    if not histories:
        raise ValueError("at least one training history is needed; got none")
    try:
        import matplotlib
        from matplotlib.backends.backend_svg import FigureCanvasSVG
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("the training figure", "report") from error

    runs = {kind: [h for h in histories if h.targets == kind] for kind in COLOURS}
    runs = {kind: group for kind, group in runs.items() if group}
    figure = Figure(figsize=SIZE_INCHES, layout="constrained")
    FigureCanvasSVG(figure)
    (loss, value), (lag, held_out) = figure.subplots(2, 2)
    _draw_loss(loss, runs)
    _draw_values(value, runs)
    _draw_lag(lag, runs)
    _draw_held_out(held_out, runs)
    content = io.BytesIO()
    # text stays text, and the same runs give the same bytes
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "binocal"}):
        figure.savefig(content, format="svg", metadata={"Date": None, "Title": "Training of the calibration agent"})
    return content.getvalue()


Runs = dict[str, list[TrainingHistory]]


def _draw_loss(axes: Axes, runs: Runs) -> None:
    axes.set(
        title="Critic loss", xlabel="iteration (gradient update)", ylabel="squared TD error (reward²)", yscale="log"
    )
    for kind, group in runs.items():
        _curve(axes, kind, group, [(h.step, smoothed(h.critic_loss)) for h in group])
        converged = [h.converged_step for h in group]
        found = [step for step in converged if step is not None]
        if found:
            step = int(np.median(found))
            axes.axvline(step, color=COLOURS[kind], linestyle=":", linewidth=1, label=f"{kind}: converged at {step}")
    _legend(axes)


def _draw_values(axes: Axes, runs: Runs) -> None:
    axes.set(
        title="Critic against Monte-Carlo returns",
        xlabel="discounted return that followed (reward)",
        ylabel="value predicted (reward)",
    )
    ends: list[float] = []
    for kind, group in runs.items():
        for i, h in enumerate(group):
            every = max(1, -(-len(h.value_predicted) // MAX_VALUES_DRAWN))
            got, want = h.value_predicted[::every], h.value_monte_carlo[::every]
            ends += [float(v) for side in (got, want) if len(side) for v in (side.min(), side.max())]
            mark = MARKERS[kind] or "x"
            axes.plot(
                want, got, mark, color=COLOURS[kind], markersize=3, alpha=0.5, label=None if i else f"{kind} targets"
            )
    if ends:
        span = (min(ends), max(ends))
        axes.plot(span, span, color="0.4", linewidth=1, label="exact")
        _legend(axes)


def _draw_lag(axes: Axes, runs: Runs) -> None:
    axes.set(
        title="Target lag", xlabel="iteration (gradient update)", ylabel="RMS parameter difference, actor to target"
    )
    for kind, group in runs.items():
        known = [np.isfinite(h.target_lag) for h in group]
        _curve(axes, kind, group, [(h.step[k], h.target_lag[k]) for h, k in zip(group, known, strict=True)])
    _legend(axes)


def _draw_held_out(axes: Axes, runs: Runs) -> None:
    axes.set(
        title="Held-out rigs", xlabel="iteration (gradient update)", ylabel="rigs that arrive (%), solid", ylim=(0, 103)
    )
    right = axes.twinx()
    right.set_ylabel("mean iterations to arrive, dashed")
    for kind, group in runs.items():
        _curve(axes, kind, group, [(h.held_out_step, 100 * h.held_out_success) for h in group])
        _curve(right, kind, group, [(h.held_out_step, h.held_out_iterations) for h in group], linestyle="--")
    _legend(axes)


def _legend(axes: Axes) -> None:
    """A legend below the panel, where it hides nothing, unless nothing was drawn."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.17), frameon=False)


def _curve(
    axes: Axes,
    kind: str,
    group: list[TrainingHistory],
    lines: list[tuple[Int[ndarray, "_"], Float[ndarray, "_"]]],
    linestyle: str = "-",
) -> None:
    """The median over runs and, of several, the band from least to greatest."""
    lines = [(x, y) for x, y in lines if len(x)]
    if not lines:
        return
    steps = lines[0][0]
    steps = steps[steps <= min(x[-1] for x, _ in lines)]
    steps = steps[:: max(1, -(-len(steps) // MAX_POINTS_DRAWN))]
    values = np.stack([np.interp(steps, x, y) for x, y in lines])
    n = len(lines)
    what = "seeds" if len({run.seed for run in group}) == n else "runs"
    label = f"{kind} targets, seed {group[0].seed}" if n == 1 else f"{kind} targets, {n} {what}: median, min to max"
    look = {"color": COLOURS[kind], "linestyle": linestyle, "linewidth": 1.2, "marker": MARKERS[kind], "markersize": 3}
    axes.plot(steps, np.median(values, axis=0), markevery=max(1, len(steps) // MARKED), label=label, **look)
    if n > 1:
        band = axes.fill_between(
            steps, values.min(axis=0), values.max(axis=0), color=COLOURS[kind], alpha=0.2, linewidth=0
        )
        band.set_gid(f"band-{kind}-{axes.get_title() or 'iterations'}".replace(" ", "-").lower())
