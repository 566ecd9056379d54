"""Progress of long calls in notebooks."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any


def notebook_bar() -> Callable[[str, int, int], None] | None:
    """A bar of tqdm's for one call, in a Jupyter notebook that has tqdm; else `None`."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if type(shell).__name__ != "ZMQInteractiveShell":
        return None
    try:
        from tqdm.auto import tqdm
    except ImportError:
        return None
    bars: dict[str, Any] = {}

    def tell(stage: str, done: int, total: int) -> None:
        bar = bars.get(stage)
        if bar is None or bar.disable or bar.n > done:
            bar = bars[stage] = tqdm(total=total, desc=stage)
        bar.total = total
        bar.update(done - bar.n)
        if done >= total:
            bar.close()

    return tell
