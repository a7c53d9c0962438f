"""Standard output and error that somebody has stopped reading, as `| head -1` does, or that have no room left."""

from __future__ import annotations

import io
import signal
import sys
from typing import Any

from warpqem.cli.messages import EXIT_FAILED, EXIT_SIGNAL, print_message

__all__ = ["ToleratedOutput"]


class _Stream(io.FileIO):
    """A file that takes what nobody reads any more, or has no room for, and remembers that it did."""

    is_closed_by_reader = False
    failure: OSError | None = None

    def write(self, data: Any) -> int:
        try:
            return super().write(data) or 0
        except BrokenPipeError:
            self.is_closed_by_reader = True
        except OSError as error:
            # Text that is lost, as on a full disk, is no reason to lose the work: it is said when that is done.
            self.failure = error
        return memoryview(data).nbytes


class ToleratedOutput:
    """The streams of this process from now on: the work goes on when nobody reads what it prints."""

    def __init__(self) -> None:
        self._streams: dict[str, _Stream] = {}
        # None where a stream was closed before the command began.
        if sys.stdout is not None:
            sys.stdout = self._replace("stdout", sys.stdout)
        if sys.stderr is not None:
            sys.stderr = self._replace("stderr", sys.stderr)

    def _replace(self, name: str, stream: Any) -> io.TextIOWrapper:
        stream.flush()
        raw = _Stream(stream.fileno(), "w", closefd=False)
        self._streams[name] = raw
        return io.TextIOWrapper(
            io.BufferedWriter(raw),
            stream.encoding,
            stream.errors,
            line_buffering=stream.line_buffering or stream.write_through,
            write_through=stream.write_through,
        )

    def finish(self, quiet: bool = False) -> int:
        """Flush the streams; returns 0, or the exit code where output could not be written.

        Args:
            quiet: An error has been printed already.
        """
        is_closed = any(stream.is_closed_by_reader for stream in self._streams.values())
        code = EXIT_SIGNAL + signal.SIGPIPE if is_closed else 0
        for name, raw in self._streams.items():
            getattr(sys, name).flush()
            if raw.failure is not None:
                if name == "stdout" and not quiet:
                    print_message("error", f"standard output: cannot be written ({raw.failure.strerror})")
                code = code or EXIT_FAILED
        return code
