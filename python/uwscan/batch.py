"""Archives: all recordings of a folder become clouds, on Dask's workers (``pip install uwscan[dask]``).

The same call serves a laptop and a cluster (`address`), and the same core serves the command ``uwscan batch``: each recording by itself,
on one thread; a cloud under a temporary name, then renamed; a small file beside it with the hash of what it follows from, so that a second
run does only what is missing. A recording that fails is a row of the table and stops nothing.
"""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import _uwscan, errors

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["run"]

#: Times that a recording may bring a worker down before it counts as failed.
ATTEMPTS = 3


def run(
    folder: str | os.PathLike[str],
    *,
    calibration: str | os.PathLike[str],
    output: str | os.PathLike[str],
    address: str | None = None,
    client: Any = None,
    workers: int | None = None,
    parquet: bool = True,
    progress: Callable[[str, int, int], object] | None = None,
    **settings: Any,
) -> list[dict[str, Any]]:
    """Reconstructs all recordings under a folder with one calibration.

    Parameters
    ----------
    folder : path
        With capture folders and recordings (.mcap), in its folders too. Workers must see it, and `output`, under the same paths.
    calibration : path
        Calibration file of the instrument.
    output : path
        Folder for the clouds, their results, and the table.
    address : str, optional
        A Dask scheduler, such as "tcp://10.0.0.1:8786"; workers of this machine by default.
    client : dask.distributed.Client, optional
        A client that is there already, instead.
    workers : int, optional
        Worker processes on this machine, one thread each; one a processor by default.
    parquet : bool, default True
        Write the table as table.parquet besides table.csv, where pyarrow is installed.
    progress : callable, optional
        Told of progress as ``progress("recordings", done, total)``.
    **settings
        `refraction`, `frame`, `stripe`, `medium`, `water_index`, `water`: as `uwscan.reconstruct` has them.

    Returns
    -------
    list of dict
        A row a recording, in the order of their names: recording, status ("done", "with_loss", "failed", "skipped"), key, points, frames,
        lost, index, seconds, message, and kept: whether it was there already.

    Raises
    ------
    CaptureError
        Where there is no recording in the folder.
    FileError, FormatError
        Where the calibration can't be read.
    InputError
        For a setting that can't be.
    ImportError
        Without dask.distributed.
    """
    try:
        # It has no types to check by.
        distributed: Any = importlib.import_module("distributed")
    except ImportError as e:
        raise ImportError("uwscan.batch needs Dask: pip install uwscan[dask]") from e
    source, target = Path(folder).absolute(), Path(output).absolute()
    file = Path(calibration).absolute()
    # What no recording could be made with is told at once, not once a recording.
    _uwscan.Calibration.load(file)
    jobs = _uwscan.batch_jobs(source)
    target.mkdir(parents=True, exist_ok=True)
    unknown = settings.keys() - {"refraction", "frame", "stripe", "medium", "water_index", "water"}
    if unknown:
        raise errors.InputError(f"batch.run has no setting {', '.join(sorted(unknown))}")

    cluster = None
    if client is None:
        if address is None:
            number = min(workers or os.cpu_count() or 1, len(jobs))
            cluster = distributed.LocalCluster(n_workers=number, threads_per_worker=1, processes=True, dashboard_address=None)
        client = distributed.Client(address if cluster is None else cluster)
        ours = True
    else:
        ours = False
    try:
        futures = {
            client.submit(
                _one, name, str(path), str(file), str(target), **settings,
                key=f"uwscan-{name}-{os.urandom(4).hex()}", pure=False, retries=ATTEMPTS,
            ): (name, path)
            for name, path in jobs
        }  # fmt: skip
        rows: dict[str, dict[str, Any]] = {}
        for future in distributed.as_completed(list(futures)):
            name, path = futures[future]
            error = future.exception()
            if isinstance(error, errors.InputError):
                raise error
            if error is None:
                rows[name] = future.result()
            else:
                rows[name] = _uwscan.batch_fail(name, path, target, f"{type(error).__name__}: {error}")
            if progress is not None:
                progress("recordings", len(rows), len(jobs))
    finally:
        if ours:
            client.close()
        if cluster is not None:
            cluster.close()
    _uwscan.batch_table(jobs, target)
    made = [rows[name] for name, _ in jobs]
    if parquet:
        _write_parquet(made, target / "table.parquet")
    return made


def _one(name: str, path: str, calibration: str, output: str, **settings: Any) -> dict[str, Any]:
    """What a worker does: a function of Python's, which can be pickled."""
    return _uwscan.batch_one(name, path, calibration, output, **settings)


def _write_parquet(rows: list[dict[str, Any]], path: Path) -> None:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        return
    temporary = path.with_suffix(".parquet.tmp")
    parquet.write_table(pyarrow.Table.from_pylist(rows), temporary)
    temporary.replace(path)
