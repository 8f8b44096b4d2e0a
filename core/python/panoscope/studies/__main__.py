"""Answers a request of the commands `panoscope batch`, `report` and `worst`, an object of JSON. Exit codes are those of the command: 0 done, 1 a run
failed, 2 what was asked for is wrong."""

from __future__ import annotations

import json
import sys
from typing import Any

from ..errors import PanoscopeError
from .driver import Study, of_words
from .report import number, report
from .worst import worst

_MAX_FAILURES = 20


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _batch(request: dict[str, Any]) -> int:
    study: Study = of_words(request, _say)
    for run, error in list(study.failures.items())[:_MAX_FAILURES]:
        print(f"failed {run}: {error.splitlines()[0]}")
    if len(study.failures) > _MAX_FAILURES:
        print(f"and {len(study.failures) - _MAX_FAILURES} more: column `error` of {study.table / 'runs.parquet'}")
    for note in study.notes:
        print(f"note: {note}")
    counts = ", ".join(f"{count} {name}" for name, count in sorted(study.counts.items()) if count)
    print(f"{study.folder}: {study.runs} runs: {counts}")
    if study.failures:
        print("failed runs are run again with --retry")
    return 1 if study.failures else 0


def _report(request: dict[str, Any]) -> int:
    names = ("measures", "larger", "smaller")
    page = report(request["studies"], request["html"], by=request["by"] or None, **{name: request[name] for name in names})
    print(page)
    return 0


def _worst(request: dict[str, Any]) -> int:
    rows = worst(request["study"], request["measure"], request["n"], larger=request["larger"] or None, record=request["record"])
    for row in rows:
        print(f"{number(row['value'])}  {row.get('recording', row['folder'])}")
    return 0


def main() -> int:
    """Reads the request and answers it."""
    request = json.loads(sys.argv[1])
    try:
        return {"batch": _batch, "report": _report, "worst": _worst}[request["command"]](request)
    except KeyboardInterrupt:
        _say("stopped; the same command goes on where it was")
        return 130
    except (PanoscopeError, ImportError) as error:
        _say(f"error: {error}")
        return 2


if __name__ == "__main__":
    sys.exit(main())
