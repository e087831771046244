"""Independent calls side by side, each in a process of its own.

A call that raises, runs out of memory or crashes costs the others nothing, its peak memory is its own, and ending the
command ends them all. Each process uses one thread, so that several do not fight for the same cores.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing import connection
from typing import Any

from leanboom import resources
from leanboom.errors import LeanboomError

PRELOADED = (
    "leanboom.planning.planner",
    "leanboom.fixed_mode.modes",
    "leanboom.evaluation.evaluate",
    "scipy.signal",  # to filter what is judged; with `scipy.interpolate`, of paths, a second of processor time
)  # what every process needs, imported once
STARTING, VALUE, REFUSAL, FAILURE = "starting", "value", "refusal", "failure"


@dataclass(frozen=True, slots=True)
class CallResult:
    """Result or error of a call."""

    value: Any = None
    failure: str = ""  # why there is no value, as a sentence
    refused: bool = False  # whether the function itself said so: the same call would fail again

    @property
    def failed(self) -> bool:
        """Whether there is no value."""
        return bool(self.failure)


def each(
    function: Callable[[Any], Any],
    arguments: Sequence[Any],
    workers: int | None = None,
    done: Callable[[int, CallResult], None] | None = None,
) -> list[CallResult]:
    """Call a function with every argument, as many at a time as there are workers.

    Args:
        function: A function of a module, of one argument; both, and its value, must be picklable.
        arguments: The arguments, one a call.
        workers: Calls at a time; None: one a core.
        done: Called in this process whenever a call has ended, with its index and result.

    Returns:
        The results, in the order of the arguments.

    Raises:
        LeanboomError: If processes cannot start.
    """
    context = resources.process_context(PRELOADED)
    waiting = list(range(len(arguments)))[::-1]
    results = [CallResult() for _ in arguments]
    running: dict[Any, tuple[int, Any, list]] = {}
    try:
        while waiting or running:
            while waiting and len(running) < max(1, workers or resources.cores()):
                index = waiting.pop()
                here, there = context.Pipe(duplex=False)
                process = context.Process(target=_call, args=(there, function, arguments[index]), daemon=True)
                process.start()
                there.close()
                running[here] = index, process, []
            for pipe in connection.wait(list(running)):
                index, process, said = running[pipe]
                if (ended := _listen(pipe, process, said)) is None:
                    continue
                del running[pipe]
                results[index] = ended
                if done is not None:
                    done(index, ended)
    finally:
        for pipe, (_, process, _) in running.items():
            process.terminate()
            process.join()
            pipe.close()
    return results


def _listen(pipe: Any, process: Any, said: list) -> CallResult | None:
    """The next message of a process: its result, or None for now."""
    try:
        word, value = pipe.recv()
    except EOFError:
        word, value = FAILURE, ""
    if word == STARTING:
        said.append(word)
        return None
    process.join()
    pipe.close()
    if word == VALUE:
        return CallResult(value)
    if value:
        return CallResult(failure=value, refused=word == REFUSAL)
    if not said:
        raise LeanboomError(
            "a process could not start; a script that calls this must do so below: if __name__ == '__main__':"
        )
    code = process.exitcode
    how = f"signal {-code}, {signal.strsignal(-code)}" if code and code < 0 else f"exit code {code}"
    return CallResult(failure=f"its process ended unexpectedly ({how})")


def _call(pipe: Any, function: Callable[[Any], Any], argument: Any) -> None:
    """Main function of a process: call the function on one thread and send the result."""
    resources.quieten()
    pipe.send((STARTING, None))
    try:
        answer = VALUE, function(argument)
    except LeanboomError as error:
        answer = REFUSAL, str(error)
    except MemoryError:
        answer = FAILURE, "out of memory"
    except Exception as error:  # whatever a method does wrong is the fate of its own call alone
        answer = FAILURE, f"{type(error).__name__}: {error}"
    pipe.send(answer)
    pipe.close()
