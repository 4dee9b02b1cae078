"""The safety case, checked and proven: `make safety` (docs/safety-case.md).

    python -m safety [--check] [--all]

Proves what is new or stale: makes each change in a copy of the checkout and sees that its test fails; then writes the page and
its pictures. With --all it proves everything again. --check proves nothing and is quick: it says which links lead to nothing,
what nobody thought about, which proof is missing or stale, and whether page and pictures are those of the records.
"""

import argparse
import sys
import tomllib
from collections.abc import Sequence

import msgspec

from safety.case import RECORDS, Case, holes, read
from safety.page import stale, write
from safety.proofs import digest, keep, kept, key, missing, prove, unproven


def checked(case: Case) -> list[str]:
    """What is wrong with the case, in words, without running a test."""
    found = holes(case)
    absent = {link: why for link in case.links() if (why := missing(link))}
    ids = {link: each.id for each in case.unsafe() for link in each.held}
    found += [f"{ids[link]}: {why}" for link, why in absent.items()]
    proofs, there = kept(), [link for link in case.links() if link not in absent]
    for link in unproven(there, proofs):
        why = "the function or the test has changed since its proof" if key(link) in proofs else "is not proven yet"
        found.append(f"{ids[link]}: {link.test} with {link.code}: {link.change}: {why}: make safety")
    found += [
        f"safety/proofs.json has a proof of nothing: {each}: make safety" for each in proofs.keys() - set(map(key, there))
    ]
    return found + [f"{path} is not what the records say: make safety" for path in stale(case)]


def proven(case: Case, everything: bool) -> list[str]:
    """Proves what is not proven, keeps each proof as it comes, and returns what cannot be, in words."""
    links = [link for link in case.links() if not missing(link)]
    proofs = {each: was for each, was in kept().items() if each in set(map(key, links))}
    found, wanted = list[str](), links if everything else unproven(links, proofs)
    for number, (link, against) in enumerate(prove(wanted), 1):
        proofs.pop(key(link), None)
        if not against:
            proofs[key(link)] = digest(link)
        keep(proofs)
        print(f"{number}/{len(wanted)} {link.test}: {against or 'fails'} with {link.code}: {link.change}", flush=True)
        found += [f"{link.test}: {link.change}: {against}"] if against else []
    keep(proofs)
    return found


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m safety", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="prove nothing, and say what is wrong")
    parser.add_argument("--all", action="store_true", help="prove everything again")
    asked = parser.parse_args(words)
    try:
        case = read()
    except (msgspec.ValidationError, tomllib.TOMLDecodeError) as error:
        print(f"{RECORDS}: {error}")
        return 1
    against = [] if asked.check else proven(case, asked.all)
    if not asked.check:
        write(case)
    complaints = [*against, *checked(case)]
    print(*complaints, sep="\n", end="\n" if complaints else "")
    return 1 if complaints else 0


if __name__ == "__main__":
    sys.exit(main())
