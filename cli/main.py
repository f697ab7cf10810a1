"""The entry point `pfaffian`: arguments in, exit code out. Commands import their stages late."""

from __future__ import annotations

import sys
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from pfaffian.cli import output
from pfaffian.cli.bench.commands import bench_app
from pfaffian.cli.options import MOST_SAMPLES, FlightSet, Generated, Json, Model, Params, SetName
from pfaffian.runtime.base.errors import EXIT_INTERRUPTED, InputError, PfaffianError

app = typer.Typer(
    name="pfaffian",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # markup would swallow what stands in square brackets
    help="From a Lagrangian and a servo-constraint to verified controller code on a target.",
)
app.add_typer(bench_app, name="bench")


def _show_version(asked: bool) -> None:
    if asked:
        output.say(f"pfaffian {version('pfaffian')}")
        raise typer.Exit


@app.callback()
def options(
    shown: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show it and end."),
    ] = False,
) -> None:
    """From a Lagrangian and a servo-constraint to verified controller code on a target."""


@app.command()
def models(json: Json = False) -> None:
    """List models, parameter sets and scenarios."""
    from pfaffian.cli.model.models import list_models

    list_models(json)


@app.command()
def derive(
    model: Model,
    set_name: SetName = None,
    form: Annotated[str, typer.Option("--format", help="text, markdown or latex.")] = "text",
    json: Json = False,
) -> None:
    """Show the equations, ADB, the control law, zero dynamics and the identities proved."""
    from pfaffian.cli.model.derive import show_derivation

    show_derivation(model, set_name, form, json)


@app.command()
def audit(
    model: Model,
    form: Annotated[str, typer.Option("--format", help="text or latex.")] = "text",
    json: Json = False,
) -> None:
    """Check every numbered equation of the source: proved, repaired, differs or not checkable."""
    from pfaffian.cli.paper.audit import show_audit

    show_audit(model, form, json)


@app.command()
def design(
    model: Model,
    set_name: SetName = None,
    params: Params = None,
    poles: Annotated[
        str, typer.Option(help="Zero-dynamics poles in 1/s to choose gains for: -6,-4+2j,-4-2j.")
    ] = "",
    riccati: Annotated[
        str, typer.Option(help="Weights Q1,..,Q2n[,R] of (q, q') to choose gains by B^T P.")
    ] = "",
    friction: Annotated[
        str, typer.Option(help="What the plant has besides: joint2_viscous=0.001,...")
    ] = "",
    box: Annotated[
        str, typer.Option(help="Intervals to find the worst poles in: theta3=5%,NAME=LOWER:UPPER.")
    ] = "",
    delay: Annotated[str, typer.Option(help='Loop delay to propose kappa for: "5 ms".')] = "",
    curve: Annotated[
        bool, typer.Option("--curve", help="Decay rate against distance to ADB = 0.")
    ] = False,
    compare: Annotated[str, typer.Option(help="Sets, or TOML files, to show beside it.")] = "",
    written: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the gains as a set, *.toml.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw the curve, *.svg.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace files that exist.")] = False,
    json: Json = False,
) -> None:
    """Choose gains by poles or weights, and show what they amount to: margins, trade-offs."""
    from pfaffian.cli.model.design import DesignFiles, design_gains
    from pfaffian.derive.design.study import Wishes

    wishes = Wishes(poles, riccati, friction, box, delay, curve or plot is not None)
    files = DesignFiles(set_name, params, compare, written, plot, force)
    design_gains(model, wishes, files, json)


@app.command()
def template(
    model: Model,
    set_name: SetName = None,
    params: Params = None,
    written: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write it to a file, *.toml.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that exists.")] = False,
    json: Json = False,
) -> None:
    """Print a parameter set to fill in: every key with its unit, its bounds and its meaning."""
    from pfaffian.cli.model.template import TemplateFiles, show_template

    show_template(model, TemplateFiles(set_name, params, written, force), json)


@app.command()
def plan(
    model: Model,
    set_name: SetName = None,
    params: Params = None,
    end_time: Annotated[
        str, typer.Option(help='When to arrive, or a range to choose from: "1.5 s", 1:3.')
    ] = "",
    torque_limit: Annotated[
        str, typer.Option(help='Instead of the set\'s: "2 N*m", or NAME=VALUE,...')
    ] = "",
    speed_limit: Annotated[str, typer.Option(help="q1=12,q2=15: limits of the rates.")] = "",
    weights: Annotated[
        str, typer.Option(help="effort=1,smoothness=0.001,speed=0.001,time=0.1 of the cost.")
    ] = "",
    start: Annotated[
        str, typer.Option(help='Where to start at rest [hanging]: "x=1 m,theta=0".')
    ] = "",
    riccati: Annotated[
        str, typer.Option(help="Weights Q1,..,Q2n[,R] of (q, q') for the row along the plan.")
    ] = "",
    seeds: Annotated[int, typer.Option(help="Random starts on the coarse grid.")] = 12,
    seed: Annotated[int, typer.Option(help="What the random starts follow from.")] = 0,
    coarse: Annotated[int, typer.Option(help="Intervals of the coarse grid.")] = 40,
    nodes: Annotated[int, typer.Option(help="Intervals of the fine grid, about.")] = 150,
    draws: Annotated[int, typer.Option(help="Runs that follow it, 5 % off, in each case.")] = 5,
    check: Annotated[
        Path | None, typer.Option(help="Only check the plan in this file against the ODE.")
    ] = None,
    written: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the plan, *.json.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw it, *.svg.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace files that exist.")] = False,
    json: Json = False,
) -> None:
    """Plan a motion from rest to the setpoint, such as a swing-up, and fly it."""
    from pfaffian.cli.model.plan import PlanFiles, plan_motion
    from pfaffian.derive.plan.wishes import Wishes

    wishes = Wishes(
        end_time, torque_limit, speed_limit, weights, start, riccati, seeds, seed, coarse, nodes
    )
    plan_motion(
        model, wishes, PlanFiles(set_name, params, check, written, plot, force), draws, json
    )


@app.command()
def generate(
    model: Model,
    set_name: SetName = None,
    params: Params = None,
    folder: Annotated[
        Path | None, typer.Option("-o", "--output", help="Default: generated/MODEL[_single].")
    ] = None,
    check: Annotated[bool, typer.Option("--check", help="Only compare; 1 on drift.")] = False,
    bake: Annotated[
        bool, typer.Option("--bake", help="Fold the one parameter set into the step.")
    ] = False,
    jacobians: Annotated[
        bool, typer.Option("--jacobians", help="Also derivatives of plant, step and closed loop.")
    ] = False,
    batch: Annotated[
        bool, typer.Option("--batch", help="Also C for many samples at once.")
    ] = False,
    precision: Annotated[str, typer.Option(help="Of the C code: double or single.")] = "double",
    plan: Annotated[
        Path | None, typer.Option(help="A plan to follow, beside those of the model.")
    ] = None,
    json: Json = False,
) -> None:
    """Write C, Python, the readable derivation and a manifest, all or nothing."""
    from pfaffian.cli.code.generate import generate_files
    from pfaffian.derive.generate_model import Extras

    extras = Extras(bake, jacobians, batch, precision, plan)
    generate_files(model, set_name, params, folder, check, extras, json)


@app.command()
def verify(
    model: Model,
    samples: Annotated[
        int, typer.Option(min=1, max=MOST_SAMPLES, help="Random inputs of each function.")
    ] = 10_000,
    target_samples: Annotated[
        int | None,
        typer.Option(
            min=0, max=MOST_SAMPLES, help="How many also run on the target [up to 20000]."
        ),
    ] = None,
    set_names: Annotated[
        list[str] | None,
        typer.Option("--set", help="Draw around this set; give several, each with --set."),
    ] = None,
    generated: Generated = None,
    json: Json = False,
) -> None:
    """Check generated Python, host C and PowerPC C against the symbolic source at 60 digits."""
    from pfaffian.cli.code.verify import verify_generated

    verify_generated(model, samples, target_samples, generated, json, tuple(set_names or ()))


@app.command()
def build(
    model: Model,
    target: Annotated[
        str, typer.Option(help="host, a target's name (pfaffian targets), or its TOML file.")
    ] = "ppc750",
    toolchain: Annotated[str, typer.Option(help="auto, zig or gcc.")] = "auto",
    folder: Annotated[
        Path | None, typer.Option("-o", "--output", help="Where to put the image.")
    ] = None,
    generated: Generated = None,
    json: Json = False,
) -> None:
    """Compile the controller for a target; report its size, stack and instructions."""
    from pfaffian.cli.code.build import build_image

    build_image(model, target, toolchain, folder, generated, json)


@app.command()
def targets(json: Json = False) -> None:
    """List the targets that firmware is built for, and their compilers."""
    from pfaffian.cli.code.targets import list_targets

    list_targets(json)


@app.command()
def simulate(
    scenario: Annotated[str, typer.Argument(help="A scenario's name, or its TOML file.")],
    set_name: FlightSet = None,
    generated: Generated = None,
    json: Json = False,
) -> None:
    """Fly a scenario with the controller on this machine."""
    from pfaffian.cli.flight.simulate import fly_scenario

    fly_scenario(scenario, None, set_name, generated, json)


@app.command()
def pil(
    scenario: Annotated[str, typer.Argument(help="A scenario's name, or its TOML file.")],
    emulator: Annotated[
        str, typer.Option(help="unicorn, qemu-user, or qemu-system: a bare machine.")
    ] = "unicorn",
    target: Annotated[str, typer.Option(help="A target's name, or its TOML file.")] = "ppc750",
    budget: Annotated[
        float, typer.Option(help="Share of a period that a step may take on the bare machine.")
    ] = 0.1,
    set_name: FlightSet = None,
    generated: Generated = None,
    json: Json = False,
) -> None:
    """Fly a scenario with the controller on an emulated target, and compare the bits."""
    from pfaffian.api.flights import Emulated
    from pfaffian.cli.flight.simulate import fly_scenario

    fly_scenario(scenario, Emulated(emulator, target, budget), set_name, generated, json)


@app.command()
def certify(
    model: Model,
    set_name: SetName = None,
    params: Params = None,
    scenario: Annotated[
        str | None, typer.Option(help="Scenario's name or TOML file [the model's first].")
    ] = None,
    region: Annotated[
        str | None,
        typer.Option(help="q1=1:2,q2=0.6,rate=8: LOW:HIGH or a half-width, rad, rad/s."),
    ] = None,
    initial: Annotated[
        str | None, typer.Option(help="q1=1,dq1=0.5: a start to fly from instead, rad, rad/s.")
    ] = None,
    generated: Generated = None,
    json: Json = False,
) -> None:
    """Put Theorem 1 into numbers over a region, beside a flight of the continuous law."""
    from pfaffian.cli.model.certify import certify_design

    certify_design(model, scenario, set_name, params, region, initial, generated, json)


@app.command()
def run(
    model: Annotated[
        str, typer.Argument(help="A model of the library, or the folder of your own.")
    ] = "pendubot",
    folder: Annotated[Path, typer.Option("-o", "--output", help="Where the report goes.")] = Path(
        "report"
    ),
    samples: Annotated[
        int, typer.Option(min=1, max=MOST_SAMPLES, help="Random inputs to verify on.")
    ] = 20_000,
    generated: Generated = None,
    json: Json = False,
) -> None:
    """Derive, generate, verify, build for PowerPC, fly it in the loop and write the report."""
    from pfaffian.cli.flight.run import run_main_job

    run_main_job(model, folder, samples, generated, json)


@app.command()
def campaign(
    spec: Annotated[str, typer.Argument(help="A campaign of this package, or a TOML file.")],
    generated: Generated = None,
    jobs: Annotated[int, typer.Option(help="Processes that share the cases.")] = 1,
    written: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the rows as CSV.")
    ] = None,
    json: Json = False,
) -> None:
    """Fly many rigs of many variants of a scenario on the twin; a row of figures a case."""
    from pfaffian.cli.flight.campaign import fly

    fly(spec, generated, jobs, written, json)


@app.command()
def reproduce(
    what: Annotated[
        str, typer.Argument(help="all, a section (section-5.3) or a figure (figure-7).")
    ] = "all",
    folder: Annotated[
        Path, typer.Option("-o", "--output", help="Where page, figures and data go.")
    ] = Path("report/reproduction"),
    json: Json = False,
) -> None:
    """Make the paper's figures and tables as measured here, and judge its claims."""
    from pfaffian.cli.paper.reproduce import reproduce as run_reproduction

    run_reproduction(what, folder, json)


def main() -> NoReturn:
    """Run the command line and end with its exit code.

    A reader of the output that went away is an end as of any other program, by SIGPIPE.
    """
    as_json = "--json" in sys.argv
    try:
        try:
            code = _run(as_json)
            output.finish()
        except InputError as error:  # of standard output itself
            code = output.complain(error)
    except BrokenPipeError:
        code = output.read_no_further()
    sys.exit(code)


def _run(as_json: bool) -> int:
    """Run one command and return its exit code; errors of ours become a message."""
    try:
        command = typer.main.get_command(app)
        with command.make_context("pfaffian", sys.argv[1:]) as context:
            command.invoke(context)
    except typer.Exit as end:
        return int(end.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        output.note("interrupted")
        return EXIT_INTERRUPTED
    except PfaffianError as error:
        return output.leave(error, as_json)
    except BrokenPipeError:
        raise
    except OSError as error:
        return output.leave(_of_system(error), as_json)
    except MemoryError:
        remedy = "ask for less at once: fewer samples, nodes, links or coordinates"
        return output.leave(InputError("there is not memory enough", remedy=remedy), as_json)
    except Exception as error:
        usage = getattr(error, "format_message", None)  # of the parser's own errors
        if usage is None:
            raise
        return output.leave(_of_usage(error, usage()), as_json)
    return 0


def _of_system(error: OSError) -> InputError:
    """Return what the system refused: a file's name, or a disk that is full or not to be found."""
    if error.filename is not None:
        return InputError(f"{error.filename}: {error.strerror}", remedy="check the path")
    return InputError(
        error.strerror or str(error),
        remedy="make room on the disk; the folder of temporary files is in TMPDIR",
    )


def _of_usage(error: Exception, message: str) -> InputError:
    """Return an error of the parser's; where nothing was asked, its message is the help."""
    context = getattr(error, "ctx", None)
    path = context.command_path if context is not None else "pfaffian"
    if type(error).__name__ == "NoArgsIsHelpError":
        output.note(message)
        message = "no command is named"
    return InputError(message, remedy=f"see {path} --help")


if __name__ == "__main__":
    main()
