"""`pfaffian bench`: the commands that measure. Each imports its stage late."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from pfaffian.cli.options import Json

bench_app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Measure against peers in the same run."
)


@bench_app.command("regenerate")
def bench_regenerate(
    model: Annotated[str, typer.Argument(help="The model.")] = "pendubot",
    runs: Annotated[int, typer.Option(min=1, help="Whole processes of each kind.")] = 5,
    json: Json = False,
) -> None:
    """Time a regeneration after a parameter change: whole processes, cold and warm."""
    from pfaffian.cli.bench.regenerate import bench_regeneration

    bench_regeneration(model, runs, json)


@bench_app.command("step")
def bench_step(
    states: Annotated[
        int, typer.Option(min=2, max=256, help="States along a flight, and as many at random.")
    ] = 64,
    passes: Annotated[int, typer.Option(min=1, help="Timed passes over the states.")] = 301,
    rows: Annotated[
        int, typer.Option(min=1, help="States of the vectorised NumPy call.")
    ] = 100_000,
    json: Json = False,
) -> None:
    """Count and time one control step: ours, CasADi's and SymPy's C, and two written by hand."""
    from pfaffian.cli.bench.step import bench_step as run_bench

    run_bench(states, passes, rows, json)


@bench_app.command("batch")
def bench_batch(
    model: Annotated[str, typer.Argument(help="The model.")] = "pendubot",
    samples: Annotated[int, typer.Option(min=1, help="Samples a call.")] = 1024,
    passes: Annotated[int, typer.Option(min=1, help="Timed calls of each.")] = 301,
    json: Json = False,
) -> None:
    """Time the batch form beside the scalar functions in a loop, on the same samples."""
    from pfaffian.cli.bench.batch import bench_batch as run_bench

    run_bench(model, samples, passes, json)


@bench_app.command("chain")
def bench_chain(
    links: Annotated[str, typer.Option(help="Numbers of links, separated by commas.")] = "2,4,6,8",
    json: Json = False,
) -> None:
    """Derive the n-link chain with this package, SymPy's methods and CasADi, in one run."""
    from pfaffian.cli.bench.chain import bench_chain as run_bench

    run_bench(links, json)


@bench_app.command("sensing")
def bench_sensing(
    delay: Annotated[
        str, typer.Option(help="Delay at 20 rad/s that the proposal may have.")
    ] = "5 ms",
    damping: Annotated[
        float | None, typer.Option(help="Of the tracking loop, 0.5 to 2 [0.707].")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw noise against delay, *.svg.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that exists.")] = False,
    json: Json = False,
) -> None:
    """Compare two velocity estimators behind an encoder: phase lag, noise; propose one."""
    from pfaffian.cli.bench.sensing import bench_sensing as run_bench

    run_bench(delay, damping, plot, force, json)
