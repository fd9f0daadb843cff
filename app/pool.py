"""Many runs of moving cases at a time, each in a process of its own.

Numba's threads would share the cores the other runs need, so each process has one. Runs that
depend on earlier ones (a bisection) are generators: they yield a run and are sent its outcome.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import tomllib
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from flexapod.app.case import LoadedCase, package_version, parse_case, put_value
from flexapod.app.outputs import CASE_FILE, SUMMARY_FILE, ResultsFolder, same_case
from flexapod.core.errors import InputError, SolverError, Status

BAD_INPUT = "bad_input"


@dataclass(frozen=True)
class Job:
    """A case to run into a folder, as it travels to a process.

    Attributes
    ----------
    table
        The case, as its file would hold it.
    source, folder
        The file it comes from, for messages, and the folder its relative paths start at.
    out
        Results folder.
    label
        For messages.
    keep
        Whether fields, pictures and checkpoints are kept.
    start_at
        Folder whose ``start`` holds the start shape; None where each run makes its own.
    """

    table: dict[str, Any]
    source: str
    folder: Path
    out: Path
    label: str
    keep: bool = False
    start_at: Path | None = None

    @property
    def loaded(self) -> LoadedCase:
        """The case, checked."""
        where = f"{self.source}: with {self.label}"
        return LoadedCase(parse_case(self.table, where), self.source, self.folder)


@dataclass(frozen=True)
class Outcome:
    """How a run ended: its status' name, or `BAD_INPUT`, and its results."""

    status: str
    message: str
    results: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def done(self) -> bool:
        """Whether it reached its end."""
        return self.status == Status.DONE.name.lower()


Task = Generator[Job, Outcome, None]


def with_values(loaded: LoadedCase, values: dict[str, Any]) -> dict[str, Any]:
    """The case's table with keys set, without its sweep and search."""
    table = loaded.case.model_dump(mode="json", by_alias=True, exclude_none=True)
    for key in ("sweep", "search", "resolved"):
        table.pop(key, None)
    table["name"] = loaded.name
    for key, value in values.items():
        put_value(table, key, value, f"{loaded.source}: {key}")
    return table


def run_job(job: Job) -> Outcome:
    """Run a job here; whatever is wrong with it is its outcome."""
    from flexapod.app.run import run_case

    try:
        result = run_case(job.loaded, job.out, lean=not job.keep, start_at=job.start_at)
    except InputError as error:
        return Outcome(BAD_INPUT, str(error))
    except SolverError as error:
        return Outcome(error.status.name.lower(), str(error))
    if result.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    heard = tuple(result.summary["warnings"])
    return Outcome(result.status.name.lower(), result.message, result.summary["results"], heard)


def kept_outcome(job: Job) -> Outcome | None:
    """Outcome of the same run done before in its folder; None without."""
    import json

    from flexapod.app.run import resolve

    try:
        summary = json.loads((job.out / SUMMARY_FILE).read_text(encoding="utf-8"))
        old = tomllib.loads((job.out / CASE_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    done = summary.get("status") == Status.DONE.name.lower()
    own = old.get("resolved", {}).get("flexapod_version") == package_version()
    if not (done and own) or same_case(resolve(job.loaded, None), old):
        return None
    return Outcome(
        summary["status"], summary["message"], summary["results"], tuple(summary["warnings"])
    )


def clear_runs(folder: Path) -> None:
    """Remove the runs of an earlier sweep or search, and only those."""
    import shutil

    for path in folder.glob("*") if folder.is_dir() else ():
        if path.is_dir() and ResultsFolder.is_results(path):
            shutil.rmtree(path)


def core_count() -> int:
    """Cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def drive(
    tasks: Sequence[Task],
    workers: int | None,
    finished: Callable[[Job, Outcome], None],
    resume: bool,
) -> None:
    """Walk through all tasks, `workers` at a time; `finished` hears each run's outcome.

    With `resume` a run done before is not repeated. Tasks do not see each other, so outcomes do
    not depend on the order in which runs end.

    Raises
    ------
    KeyboardInterrupt
        Stopped by the user; runs under way are given up.
    """
    count = min(core_count() if workers is None else workers, len(tasks))

    def next_job(task: Task, outcome: Outcome | None) -> Job | None:
        """The task's next job that has to be run."""
        while True:
            try:
                job = next(task) if outcome is None else task.send(outcome)
            except StopIteration:
                return None
            outcome = kept_outcome(job) if resume else None
            if outcome is None:
                return job
            finished(job, outcome)

    if count <= 1:
        for task in tasks:
            outcome = None
            while (job := next_job(task, outcome)) is not None:
                outcome = run_job(job)
                finished(job, outcome)
        return
    ready = deque((task, job) for task in tasks if (job := next_job(task, None)) is not None)
    with _processes(count) as executor:
        under_way: dict[Future[Outcome], tuple[Task, Job]] = {}
        while ready or under_way:
            while ready and len(under_way) < count:
                task, job = ready.popleft()
                under_way[executor.submit(run_job, job)] = (task, job)
            for future in wait(under_way, return_when=FIRST_COMPLETED).done:
                task, job = under_way.pop(future)
                outcome = future.result()
                finished(job, outcome)
                following = next_job(task, outcome)
                if following is not None:
                    ready.append((task, following))


@contextlib.contextmanager
def _processes(count: int) -> Iterator[ProcessPoolExecutor]:
    """Processes of one thread each; those that still run when the block is left early are ended."""
    before = set(multiprocessing.active_children())
    threads = os.environ.get("NUMBA_NUM_THREADS")
    os.environ["NUMBA_NUM_THREADS"] = "1"
    executor = ProcessPoolExecutor(
        count, mp_context=multiprocessing.get_context("spawn"), initializer=_begin_process
    )
    try:
        yield executor
    except BaseException:
        # A run under way may take minutes, and leaves nothing that a later one could not replace.
        for process in set(multiprocessing.active_children()) - before:
            process.kill()
        raise
    finally:
        executor.shutdown(cancel_futures=True)
        if threads is None:
            del os.environ["NUMBA_NUM_THREADS"]
        else:
            os.environ["NUMBA_NUM_THREADS"] = threads


def _begin_process() -> None:
    """Leave Ctrl-C to the parent, and end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def leave() -> None:
        assert parent is not None
        parent.join()
        os._exit(1)

    threading.Thread(target=leave, daemon=True).start()


__all__ = [
    "BAD_INPUT",
    "Job",
    "Outcome",
    "Task",
    "clear_runs",
    "core_count",
    "drive",
    "kept_outcome",
    "run_job",
    "with_values",
]
