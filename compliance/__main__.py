"""What rules ask for, tried: `make compliance` (docs/compliance.md).

    python -m compliance [--page]

Runs the tests that the records name, keeps what came of each, and writes the page. With --page it runs nothing.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

from compliance.records import PAGE, RESULTS, holes, page, read, results, tests


def ran(named: Sequence[str]) -> dict[str, str]:
    """What came of each test; one with several parameters passes where all of them do."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder, "report.xml")
        words = [sys.executable, "-m", "pytest", "-q", "-n", "2", "-p", "no:cacheprovider", "-o", "junit_family=xunit1"]
        subprocess.run([*words, f"--junitxml={report}", *named], check=False)
        cases = list(ET.parse(report).iter("testcase")) if report.exists() else []
    found = dict.fromkeys(named, "not run")
    weight = ["not run", "passed", "skipped", "failed"]
    for case in cases:
        test = f"{case.get('file')}::{(case.get('name') or '').partition('[')[0]}"
        bad = case.find("failure") is not None or case.find("error") is not None
        came = "failed" if bad else "skipped" if case.find("skipped") is not None else "passed"
        found[test] = max(found.get(test, "not run"), came, key=weight.index)
    return {test: found[test] for test in named}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m compliance", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--page", action="store_true", help="run nothing, write the page alone")
    asked = parser.parse_args()
    rules = read()
    if found := holes(rules):
        print(*found, sep="\n")
        return 1
    outcomes = results() if asked.page else ran(tests(rules))
    RESULTS.write_text(json.dumps(outcomes, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(page(rules, outcomes), encoding="utf-8")
    bad = [f"{test}: {came}" for test, came in outcomes.items() if came != "passed"]
    print(*bad, f"{len(outcomes) - len(bad)} of {len(outcomes)} tests passed; {PAGE} is written", sep="\n")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
