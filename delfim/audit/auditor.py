"""The auditor: all rules over the runs of log files, and the verdict in words."""

import time
from collections.abc import Iterable, Iterator, Sequence
from typing import Final, NamedTuple

from delfim.audit import busrules, fencerules, orderrules, recordrules, troublerules
from delfim.audit.evidence import Evidence, Sent, Unjudged, parts
from delfim.audit.rule import Finding, Rule
from delfim.base.errors import DelfimError
from delfim.logging.ashore import tree
from delfim.logging.ashore.summary import utc
from delfim.logging.ashore.table import frames, table
from delfim.logging.ashore.tree import ALWAYS, Run, Span

RULES: Final[Sequence[Rule]] = (
    *recordrules.RULES,
    *troublerules.RULES,
    *orderrules.RULES,
    *fencerules.RULES,
    *busrules.RULES,
)
SHOWN: Final = 5  # findings of a rule in one run


class Judged(NamedTuple):
    """The outcome of a rule in a run: findings, or why it could not be judged."""

    rule: Rule
    findings: tuple[Finding, ...]
    unjudged: str


class AuditedRun(NamedTuple):
    run: str
    cycles: int
    began_ns: int  # wall clock of the time since boot 0
    judged: tuple[Judged, ...]

    @property
    def findings(self) -> list[tuple[Rule, Finding]]:
        """The findings by time."""
        its = [(each.rule, finding) for each in self.judged for finding in each.findings]
        return sorted(its, key=lambda each: each[1].t_s)

    def words(self) -> list[str]:
        """The findings, a line each."""
        return [f"{finding.t_s:.1f} s: {rule.name}: {finding.words}" for rule, finding in self.findings]


def judge(evidence: Evidence) -> tuple[Judged, ...]:
    """Judge one run by all rules."""
    found = list[Judged]()
    for rule in RULES:
        try:
            found.append(Judged(rule, tuple(rule.check(evidence)), ""))
        except Unjudged as why:
            found.append(Judged(rule, (), str(why)))
    return tuple(found)


def _verdicts(run: Run, others: Iterable[Run], span: Span) -> Iterator[AuditedRun]:
    """Judge a run of the state log. `others` are those of the same time, black boxes among them. Raises DelfimError."""
    try:
        columns, _ = table(run.files, span)
    except DelfimError as why:
        yield AuditedRun(run.name, 0, run.begin_ns, tuple(Judged(rule, (), str(why)) for rule in RULES))
        return
    boxes = [file for other in others for file in other.files if file.suffix in (".log", ".log.gz")]
    sent = dict[str, list[Sent]]()
    for bus, frame in frames(boxes, span):
        if frame.identifier in busrules.USED:
            sent.setdefault(bus, []).append(Sent(frame.t_ns, frame.identifier, frame.data))
    for each in parts(run.name, columns, list(tree.events(run.files, span)), sent, list(tree.events(boxes, span))):
        began_ns = int(each.column("t1")[-1]) - round(float(each.t_s[-1]) * 1e9)
        yield AuditedRun(run.name, len(each.t_s), began_ns, judge(each))


def audit(chosen: Sequence[Run], span: Span = ALWAYS) -> list[AuditedRun]:
    """Audit all runs of a state log among these. Raises DelfimError where there is none."""
    runs = [run for run in chosen if run.id == "state"]
    if not runs:
        raise DelfimError("there is no state log to judge")
    others = {run: [other for other in chosen if other.id != run.id and tree.meet(run, other)] for run in runs}
    return [each for run in runs for each in _verdicts(run, others[run], span)]


def complaints(folder: str) -> list[str]:
    """List what is broken in the logs below a folder, in words. Raises DelfimError."""
    verdicts = audit(tree.runs(tree.files([folder]), time.time_ns()))
    return [words for each in verdicts for words in each.words()]


def text(verdicts: Sequence[AuditedRun]) -> list[str]:
    """The table of what was judged, each finding with its time, and what could not be judged."""
    lines = [f"{'RULE':26}{'RUNS':>5}{'BROKEN':>8}  WHAT MUST HOLD"]
    for i, rule in enumerate(RULES):
        its = [each.judged[i] for each in verdicts]
        runs, broken = sum(not each.unjudged for each in its), sum(bool(each.findings) for each in its)
        lines.append(f"{rule.name:26}{runs:5}{broken or '':>8}  {rule.sentence}")
    lines += [f"{len(verdicts)} runs, {sum(each.cycles for each in verdicts)} cycles"]
    for each in verdicts:
        for judged in each.judged:
            for finding in judged.findings[:SHOWN]:
                when = utc(each.began_ns + round(finding.t_s * 1e9))
                lines.append(f"BROKEN {each.run} {when} ({finding.t_s:.1f} s) {judged.rule.name}: {finding.words}")
            if len(judged.findings) > SHOWN:
                lines.append(f"BROKEN {each.run} {judged.rule.name}: and {len(judged.findings) - SHOWN} times more")
    return lines + _unjudged(verdicts)


def _unjudged(verdicts: Sequence[AuditedRun]) -> list[str]:
    whys = dict[tuple[str, str], int]()
    for each in verdicts:
        for judged in each.judged:
            if judged.unjudged:
                key = judged.rule.name, judged.unjudged
                whys[key] = whys.get(key, 0) + 1
    return [f"not judged in {count} runs: {name}: {why}" for (name, why), count in whys.items()]
