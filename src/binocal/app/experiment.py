"""``binocal experiment``: the paper's experiment as one command, to a page, its rows and its figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from binocal import __version__
from binocal.errors import DataError
from binocal.experiments.options import ExperimentOptions
from binocal.experiments.row import Row
from binocal.formats.json_document import dump_json, jsonable
from binocal.output import check_output_folder, write_together
from binocal.progress import ProgressCallback, ShouldStop
from binocal.threads import n_threads

JOURNAL, RESULTS, TIMES = "rows.jsonl", "results.json", "times.md"


@dataclass(frozen=True, slots=True, eq=False)
class ExperimentRun:
    """What came of it: the rows, the folder of the page, and whether a run that was cut went on."""

    rows: Sequence[Row]
    folder: Path
    was_resumed: bool

    def document(self) -> dict[str, Any]:
        """The content of results.json."""
        return {"rows": [row.document() for row in self.rows]}


def check_experiment_folder(output: str | Path, *, force: bool = False) -> Path:
    """The folder, if an experiment may go there: empty, or with one that was cut.

    Raises:
        OutputExistsError: It holds other files, or a whole experiment, and ``force`` is False.
        DataError: It is a file, or cannot be made.
    """
    output = Path(output)
    return check_output_folder(output, force=force or _is_cut(output))


def _is_cut(folder: Path) -> bool:
    return (folder / JOURNAL).is_file() and not (folder / RESULTS).exists()


def experiment(
    output: str | Path,
    options: ExperimentOptions | None = None,
    *,
    force: bool = False,
    progress: ProgressCallback | None = None,
    should_stop: ShouldStop | None = None,
) -> ExperimentRun:
    """Run all cases, on all processors, and write page.md, page.html, the figures, rows.csv and results.json into ``output``.

    What was cut goes on from its journal, rows.jsonl. With ``force`` a whole experiment, or one of other options, is begun anew.

    Raises:
        OutputExistsError: ``output`` holds other files, or a whole experiment, and ``force`` is False.
        FormatError: The folder holds the journal of other options.
        DataError: A folder of real data is not of its layout; nothing has run then.
        MissingExtraError: Matplotlib is not installed.
        CancelledError: ``should_stop`` returned True; the same call goes on.
    """
    from binocal.app.experiment_times import (
        MOST_TIMED,
        check_streets,
        recordings_in_colour,
        recordings_of,
        rows_of_timed,
        timed_results,
    )
    from binocal.experiments.colours import real_colour_cases
    from binocal.experiments.convergence import loss_curves
    from binocal.experiments.journal import Journal
    from binocal.experiments.page import page_files
    from binocal.experiments.paper import cases_of, experiment_document
    from binocal.experiments.paper_page import paper_page, times_text
    from binocal.experiments.real_boards import real_board_cases
    from binocal.experiments.run import rows_of, run_cases
    from binocal.experiments.stability import stability_rows
    from binocal.experiments.trained import histories_in
    from binocal.report.curves import draw_curves
    from binocal.report.training import training_drawing

    options = options or ExperimentOptions()
    folder = check_experiment_folder(output, force=force)
    check_streets(options)
    real = []
    if options.measured is not None:
        real = [
            *real_board_cases(recordings_of(options.measured)),
            *real_colour_cases(recordings_in_colour(options.measured)),
        ]
    was_resumed = _is_cut(folder) and not force
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if force:
            (folder / JOURNAL).unlink(missing_ok=True)
            (folder / RESULTS).unlink(missing_ok=True)
    except OSError as error:
        raise DataError(f"{folder}: the output's folder cannot be made: {error.strerror}.") from None
    cases, seeds = [*cases_of(options, folder), *real], options.seeds
    journal = Journal(folder / JOURNAL, experiment_document(options) | {"binocal": __version__})
    try:
        results = run_cases(
            cases, seeds, journal=journal, workers=n_threads(), progress=progress, should_stop=should_stop
        )
        for count, timed in enumerate(timed_results(options, lambda case, name: journal.has(case, name, options.seed))):
            journal.add(timed)
            if progress is not None:
                progress("times", count + 1, MOST_TIMED)
        timed_rows = rows_of_timed(options, journal.results)
    finally:
        journal.close()
    rows = [*rows_of(cases, seeds, results), *stability_rows(cases, seeds, results), *timed_rows]
    run = ExperimentRun(rows, folder, was_resumed)
    histories = histories_in(folder, seeds)
    given = {"training.svg": training_drawing(histories).decode()} if histories else {}
    if curves := loss_curves(rows):
        title, marked = (
            "Figure 5: the loss of every solver by iteration",
            {"the paper: 30": 30.0, "its others: 70": 70.0},
        )
        given["figure-5-loss.svg"] = draw_curves(curves, "mean square of the residuals (px²)", title, marked)
    files = page_files(paper_page(options, rows), given) | {
        TIMES: times_text(rows),
        RESULTS: dump_json(jsonable(run.document())),
    }
    write_together({folder / name: content for name, content in files.items()}, force=True)
    return run
