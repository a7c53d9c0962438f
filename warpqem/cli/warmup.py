"""`warpqem warmup`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from warpqem.cli.console import EXIT_FAILED, print_message, quiet_libraries
from warpqem.cli.logs import takes_verbosity
from warpqem.cli.progress_bar import progress_bar
from warpqem.errors import OptionError

if TYPE_CHECKING:
    from warpqem.runtime.precompile import Compiled

__all__ = ["EXAMPLES", "warmup"]

# Under its help.
EXAMPLES = ("warpqem warmup", "warpqem warmup --cache /opt/warpqem-kernels --arch 90")


@takes_verbosity
def warmup(
    cache: Annotated[
        str | None,
        typer.Option(
            metavar="FOLDER",
            rich_help_panel="Output",
            help="Folder for the compiled code, which WARP_CACHE_PATH then names; by default Warp's own.",
        ),
    ] = None,
    arch: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ARCH",
            rich_help_panel="Machine",
            help="Compile for GPUs of this architecture too, such as 90 for an H100; repeat for more. By default for "
            "those of this machine.",
        ),
    ] = None,
    cpu: Annotated[
        bool, typer.Option("--cpu/--no-cpu", rich_help_panel="Machine", help="Compile for processors like this one.")
    ] = True,
    quiet: bool = False,
) -> None:
    """Compile all kernels ahead of time, on all cores: for an image, a farm, or a first run without a wait.

    What is there already is left. Code for a CPU holds for processors with the same instructions as this one, and that
    of other ones may lie in the same folder.

    Exit codes: 0 done; 1 some do not compile; 2 wrong usage; 130 interrupted.
    """
    start = time.perf_counter()
    with progress_bar("loading") as progress:
        quiet_libraries()
        made = _compile(cache, arch or [], cpu, progress)
    failed = [result for result in made if result.path is None]
    for result in failed:
        print_message("error", f"{result.name}: {' '.join(str(result.error).split())}")
    if not quiet:
        new = sum(result.seconds > 0 and result.path is not None for result in made)
        print(f"{len(made)} modules: {new} compiled in {time.perf_counter() - start:.1f} s, {_others(made, new)}")
        if cache is not None:
            print(f"to use them: WARP_CACHE_PATH={cache}")
    if failed:
        raise typer.Exit(EXIT_FAILED)


def _others(made: list[Compiled], new: int) -> str:
    failed = sum(result.path is None for result in made)
    there = f"{len(made) - new - failed} there"
    return f"{there}, {failed} failed" if failed else there


def _compile(cache: str | None, arch: list[str], cpu: bool, progress: Any) -> list[Compiled]:
    """Compile for the CPU and for GPUs, and show how far it is."""
    import warp as wp

    from warpqem.runtime.cpu_kernels import compile_ahead, cpu_modules
    from warpqem.runtime.device import resolve_device
    from warpqem.runtime.precompile import compile_modules, gpu_modules, read_architecture

    try:
        architectures = sorted({read_architecture(text) for text in arch})
    except ValueError as error:
        raise OptionError(f"`arch`: {error}") from None
    if cache is not None:
        _make_folder(cache)
        wp.config.kernel_cache_dir = cache
    resolve_device("cpu")
    architectures = architectures or sorted({device.arch for device in wp.get_cuda_devices()})
    parts = len(architectures) + cpu
    if not parts:
        raise OptionError("`arch` is needed with --no-cpu: this machine has no GPU")
    made: list[Compiled] = []

    def report(what: str, index: int) -> Any:
        def show(done: int, total: int, result: Compiled) -> None:
            progress((index + done / total) / parts, f"{what}: {done} of {total}, {result.name}")

        return show

    if cpu:
        progress(0.0, "CPU")
        made += compile_ahead(cpu_modules(), report("CPU", 0))
    for index, architecture in enumerate(architectures, int(cpu)):
        made += compile_modules(architecture, gpu_modules(), report(f"sm_{architecture}", index))
    return made


def _make_folder(cache: str) -> None:
    try:
        Path(cache).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OptionError(f"`cache`: {cache} cannot be made ({error.strerror})") from error
