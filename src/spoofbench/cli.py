"""The command line: words in, functions called, errors as one sentence. Heavy imports wait until a
command runs.
"""

import signal
import sys
from contextlib import closing
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn, Optional

import typer

from spoofbench.commands import CommandGroup
from spoofbench.terminal import (
    complain,
    print_json,
    print_lines,
    progress_bars,
    read_parameters,
)

app = typer.Typer(
    name="spoofbench",
    cls=CommandGroup,
    help=(
        "Convert GNSS and IMU logs, spoof them, and rank spoofing detectors with honest intervals."
    ),
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

MAX_S, MAX_SEED = 1e9, 2**63 - 1

AsJson = Annotated[bool, typer.Option("--json", help="Print for machines.")]
Parameters = Annotated[
    list[str] | None,
    typer.Option("-p", "--parameter", metavar="KEY=VALUE", help="Parameter; repeat for more."),
]


@app.callback()
def root(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", is_eager=True)
    ] = False,
) -> None:
    if version:
        from spoofbench import __version__

        typer.echo(__version__)
        raise typer.Exit


@app.command()
def demo(
    out: Annotated[Path, typer.Option("-o", help="Folder for everything that is made.")] = Path(
        "demo"
    ),
    workers: Annotated[Optional[int], typer.Option(help="Tasks at a time.")] = None,  # noqa: UP045
) -> None:
    """Run the whole chain on real recordings."""
    from spoofbench.demo import demonstrate

    with progress_bars() as progress:
        made = demonstrate(out, workers, progress)
    _leaderboard(out / "results")
    if made.without:
        complain(made.without)
    typer.echo(f"report: {made.page}")


@app.command()
def convert(
    inputs: Annotated[
        list[Path], typer.Argument(metavar="IN...", help="Raw logs: files, folders or archives.")
    ],
    out: Annotated[Path, typer.Option("-o", help="A file for one log, a folder for several.")],
    log_format: Annotated[
        str | None, typer.Option("--format", help="Converter to use; else found by content.")
    ] = None,
    date: Annotated[
        str | None,
        typer.Option(metavar="YYYY-MM-DD", help="Date of a log that does not say it."),
    ] = None,
    source: Annotated[
        str | None, typer.Option(help="The one receiver, provider or talker to take.")
    ] = None,
    append_clock: Annotated[
        bool, typer.Option("--append-clock", help="Go on where a clock jumps back.")
    ] = False,
    mapping: Annotated[
        str | None, typer.Option(metavar="FILE|NAME", help="Mapping of a table's columns.")
    ] = None,
    options: Parameters = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Fail at anything that must be skipped.")
    ] = False,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Logs at a time; else one per processor.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Convert raw logs and account for every part."""
    from spoofbench.conversion.batch import ConversionRequest, convert_job, convert_many, plan
    from spoofbench.conversion.output import as_rows, as_table

    named = {
        "date": date,
        "source": source,
        "append_clock": "true" if append_clock else None,
        "mapping": mapping,
    }
    optional = {name: text for name, text in named.items() if text is not None}
    jobs = plan(inputs, out, log_format)
    with progress_bars() as progress:
        if len(jobs) == 1 and not jobs[0].found_in_folder:
            request = ConversionRequest(
                log_format, {**optional, **read_parameters(options)}, {}, strict
            )
            outcomes = [convert_job(jobs[0], request, progress(f"convert {jobs[0].source.name}"))]
        else:
            request = ConversionRequest(log_format, read_parameters(options), optional, strict)
            step = progress(f"convert {len(jobs)} logs")
            with closing(convert_many(jobs, request, workers=workers, progress=step)) as made:
                outcomes = sorted(made, key=lambda outcome: jobs.index(outcome.job))
    ledger = outcomes[0].ledger
    if as_json:
        print_json(as_rows(outcomes))
    elif len(outcomes) > 1:
        print_lines(as_table(outcomes))
    elif ledger:
        print_lines([str(outcomes[0].job.target), *ledger.as_text().split("\n")])
    failed = [
        outcome
        for outcome in outcomes
        if outcome.status == "failed"
        or (outcome.ledger is None and not outcome.job.found_in_folder)
    ]
    for outcome in failed:
        complain(
            f"{outcome.job.source}: {outcome.reason}" if len(outcomes) > 1 else str(outcome.reason)
        )
    for reason in sorted(
        {outcome.reason for outcome in outcomes if outcome.reason and outcome not in failed}
    ):
        complain(reason)
    if failed or not any(outcome.ledger for outcome in outcomes):
        raise typer.Exit(1)


@app.command()
def fetch(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME...", help="Recordings or suites; without, what there is."),
    ] = None,
    mirror: Annotated[
        list[Path] | None,
        typer.Option("--from", help="Folder to take files from instead of the network; repeat."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Download the recordings of the suites."""
    from spoofbench import fetch as fetching

    if names:
        with progress_bars() as progress:
            made = {
                name: str(fetching.fetch(name, mirror or (), progress(f"fetch {name}")))
                for name in fetching.names_of(names)
            }
        if as_json:
            print_json(made)
        else:
            print_lines(made.values())
        return
    rows = [
        {
            "name": each.name,
            "class": each.sensor_class,
            "session": each.session,
            "licence": each.licence,
            "credit": each.credit,
            "title": each.title,
            "cached": fetching.cached_path(each.name).is_file(),
        }
        for each in fetching.recipes().values()
    ]
    if as_json:
        print_json(rows)
    else:
        print_lines(
            [
                f"{'*' if row['cached'] else ' '} {row['name']:<32} {row['class']:<16} "
                f"{row['title']} ({row['credit']}, {row['licence']})"
                for row in rows
            ]
        )


@app.command()
def info(file: Path, as_json: AsJson = False) -> None:
    """Say what a recording holds."""
    from spoofbench.info import as_dict, as_text, summarise

    summary = summarise(file)
    if as_json:
        print_json(as_dict(summary))
    else:
        typer.echo(as_text(summary))


@app.command()
def doctor(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...", help="Recordings, or raw logs, which are converted for it."
        ),
    ],
    log_format: Annotated[
        str | None,
        typer.Option("--format", help="Converter of raw logs; else found by content."),
    ] = None,
    options: Parameters = None,
    as_json: AsJson = False,
) -> None:
    """Say what is wrong with a log or recording.

    Exit code: 0 nothing above info, 3 warnings, 4 errors; 1 if a file cannot be examined.
    """
    from spoofbench.doctor import as_rows, as_text, examine_file
    from spoofbench.errors import SpoofbenchError

    found: dict[str, Any] = {}
    for file in files:
        try:
            found[str(file)] = examine_file(file, log_format, read_parameters(options))
        except (SpoofbenchError, OSError) as error:
            complain(f"{file}: {error}" if len(files) > 1 else str(error))
    if as_json:
        print_json({name: as_rows(findings) for name, findings in found.items()})
    elif found:
        typer.echo("\n\n".join(as_text(name, findings) for name, findings in found.items()))
    worst = {finding.severity for findings in found.values() for finding in findings}
    code = (
        1 if len(found) < len(files) else 4 if "error" in worst else 3 if "warning" in worst else 0
    )
    if code:
        raise typer.Exit(code)


@app.command()
def export(
    file: Path,
    out: Annotated[
        Path,
        typer.Option("-o", help="X.parquet, X.csv, X.gpx; a folder or X.zip for a file per topic."),
    ],
    topics: Annotated[
        list[str] | None, typer.Option("--topic", help="Topic to write; repeat for more.")
    ] = None,
    table_format: Annotated[
        Literal["csv", "parquet"],
        typer.Option("--format", help="Of the files in a folder or X.zip."),
    ] = "csv",
    mapping: Annotated[
        str | None,
        typer.Option(metavar="FILE|NAME", help="Write the tables that this mapping reads."),
    ] = None,
) -> None:
    """Write topics for other programs."""
    from spoofbench.export import export as export_topics
    from spoofbench.export import export_by_mapping

    if out.resolve() == file.resolve():
        raise typer.BadParameter(f"{str(out)!r} is the recording itself")
    if mapping is not None:
        if topics:
            raise typer.BadParameter("a mapping says which topics it takes; leave out --topic")
        export_by_mapping(file, out, mapping)
        print_lines([f"{out}: by the mapping {mapping}"])
    else:
        print_lines(
            [
                f"{out}: {topic}"
                for topic in export_topics(
                    file, out, topics=topics or (), table_format=table_format
                )
            ]
        )


@app.command()
def attack(
    file: Path,
    name: Annotated[
        str, typer.Option("-a", "--attack", help="Attack to make; see `spoofbench plugins`.")
    ],
    out: Annotated[Path, typer.Option("-o", help="Variant to write.")],
    parameters: Parameters = None,
    donors: Annotated[
        list[Path] | None,
        typer.Option("--donor", help="Recording that supplies foreign signals."),
    ] = None,
    start: Annotated[
        float | None,
        typer.Option(min=0, max=MAX_S, help="Seconds after the first row; else drawn by the seed."),
    ] = None,
    duration: Annotated[float, typer.Option(min=0, max=MAX_S, help="Seconds.")] = 120.0,
    seed: Annotated[int, typer.Option(min=0, max=MAX_SEED, help="Seed of all chance.")] = 0,
    as_json: AsJson = False,
) -> None:
    """Write a spoofed variant with its truth."""
    from spoofbench.attacks.contract import attack_file

    if out.resolve() in {clean.resolve() for clean in (file, *(donors or []))}:
        raise typer.BadParameter(
            f"the variant {str(out)!r} would take the place of a recording that it is made from"
        )
    rows = attack_file(
        file,
        out,
        name,
        read_parameters(parameters),
        donors or [],
        start_s=start,
        duration_s=duration,
        seed=seed,
    )
    if as_json:
        print_json(rows)
    else:
        for row in rows:
            typer.echo(
                f"{out}: {row['attack']} from {row['start_s']:.3f} s to {row['end_s']:.3f} s, "
                f"strength {row['strength']:g} {row['strength_unit']}, sources {row['sources']}"
            )
        if not rows:
            typer.echo(f"{out}: strength 0, nothing changed")


@app.command()
def label(
    file: Path,
    labels: Annotated[
        Path,
        typer.Option("--from", metavar="TOML|CSV", help="Labels: attacked and clean intervals."),
    ],
    out: Annotated[Path, typer.Option("-o", help="Labelled recording to write.")],
    replace: Annotated[
        bool, typer.Option("--replace", help="Exchange the labels that are there.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Say where a recording was really attacked."""
    from dataclasses import asdict

    from spoofbench.info import labels_text, summarise_labels
    from spoofbench.labels import label_file

    if out.resolve() in (file.resolve(), labels.resolve()):
        raise typer.BadParameter(f"{str(out)!r} would take the place of what it is made from")
    summary = summarise_labels(label_file(file, labels, out, replace=replace))
    if as_json:
        print_json(asdict(summary))
    else:
        print_lines([f"{out}: {labels_text(summary)}"])


@app.command()
def run(
    suite: Annotated[
        Path, typer.Argument(metavar="SUITE", help="A suite's file, or the name of a shipped one.")
    ],
    out: Annotated[Path, typer.Option("-o", help="Results folder.")],
    workers: Annotated[
        int | None, typer.Option(help="Tasks at a time; else one per processor.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Do what is missing in a results folder.")
    ] = False,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="With --resume, run failed tasks again.")
    ] = False,
) -> None:
    """Run a suite of detectors, and score it.

    Recordings that are not in the cache are fetched first.

    Exit code: 0 done, 3 some tasks failed; 1 if the suite cannot be run.
    """
    from spoofbench.fetch import fetch as fetch_recording
    from spoofbench.results import FAILURES, read_tasks
    from spoofbench.runner import run as run_suite
    from spoofbench.suite import find_suite, load_suite

    loaded = load_suite(find_suite(suite))
    missing = [each.recipe for each in loaded.recordings if each.recipe and not each.path.exists()]
    with progress_bars() as progress:
        if missing:
            step = progress(f"fetch {len(missing)} recordings")
            for number, name in enumerate(missing, start=1):
                fetch_recording(name)
                step(number / len(missing))
        run_suite(
            loaded,
            out,
            workers=workers,
            resume=resume,
            retry_failed=retry_failed,
            progress=progress("run"),
        )
    _leaderboard(out)
    tasks = read_tasks(out)
    failed = [task for task in tasks if task.status in FAILURES]
    if failed:
        complain(
            f"{len(failed)} of {len(tasks)} tasks failed, such as {failed[0].detector} on "
            f"{failed[0].recording}: {failed[0].reason}"
        )
        raise typer.Exit(3)


@app.command()
def score(results: Path) -> None:
    """Score again from the raw decisions."""
    from spoofbench.scoring.score import score_folder

    score_folder(results)
    _leaderboard(results)


@app.command()
def report(
    results: Path,
    out: Annotated[Path, typer.Option("-o", help="Folder for the page.")],
    markdown: Annotated[
        bool, typer.Option("--markdown", help="Print the leaderboard as Markdown.")
    ] = False,
) -> None:
    """Write the page and print the leaderboard."""
    from spoofbench import report as reports
    from spoofbench.scoring.leaderboard import leaderboard

    board = leaderboard(results)
    page = reports.write_site(results, board, out)
    if markdown:
        typer.echo(reports.markdown(board))
    else:
        reports.print_leaderboard(board)
    typer.echo(f"report: {page}", err=markdown)


@app.command()
def compare(
    a: Annotated[Path, typer.Argument(metavar="A", help="Results folder.")],
    b: Annotated[Path, typer.Argument(metavar="B", help="Another, over the same material.")],
    as_json: AsJson = False,
) -> None:
    """Say how two results folders differ, and why."""
    from dataclasses import asdict

    from spoofbench.scoring.differences import differences

    found = differences(a, b)
    if as_json:
        print_json(asdict(found))
    else:
        from rich.console import Console

        from spoofbench.report.comparison_table import print_differences

        print_differences(found, Console())


@app.command()
def plugins(as_json: AsJson = False) -> None:
    """List converters, attacks, detectors and commands."""
    from spoofbench import plugins as installed

    rows = [
        {
            "kind": installed.role(group),
            "name": p.name,
            "distribution": p.distribution,
            "version": p.version,
        }
        for group in (
            installed.CONVERTERS,
            installed.ATTACKS,
            installed.DETECTORS,
            installed.COMMANDS,
        )
        for p in installed.found(group).values()
    ]
    if as_json:
        print_json(rows)
    else:
        for row in rows:
            typer.echo(
                f"{row['kind']:<12} {row['name']:<20} {row['distribution']} {row['version']}"
            )


@app.command()
def check(name: str, parameters: Parameters = None, as_json: AsJson = False) -> None:
    """Hold a detector or an attack to its contract."""
    from spoofbench import plugins as installed
    from spoofbench.testing import run_attack_checks, run_detector_checks

    is_attack = name in installed.found(installed.ATTACKS) and name not in installed.found(
        installed.DETECTORS
    )
    results = (run_attack_checks if is_attack else run_detector_checks)(
        name, read_parameters(parameters)
    )
    if as_json:
        print_json([{"check": r.name, "passed": r.passed, "reason": r.reason} for r in results])
    else:
        for result in results:
            typer.echo(
                f"{'pass' if result.passed else 'FAIL'}  "
                f"{result.name}{'' if result.passed else ': ' + (result.reason or '')}"
            )
    if not all(result.passed for result in results):
        raise typer.Exit(1)


def main() -> None:
    """Run the command line; what a user can cause ends in one sentence and exit code 1."""
    from spoofbench.errors import SpoofbenchError

    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _end)
    try:
        app()
    except SpoofbenchError as error:
        _fail(str(error))
    except OSError as error:
        _fail(f"{error.filename or 'the output'}: {error.strerror or error}")
    except MemoryError:
        _fail("this takes more memory than there is")


def _end(number: int, _: Any) -> NoReturn:
    """Tidy up what is under way on the way out, and let no second signal disturb that."""
    for ending in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(ending, signal.SIG_IGN)
    sys.exit(128 + number)


def _fail(reason: str) -> NoReturn:
    complain(reason)
    sys.exit(1)


def _leaderboard(results: Path) -> None:
    from spoofbench.report import print_leaderboard
    from spoofbench.scoring.leaderboard import leaderboard

    print_leaderboard(leaderboard(results))
