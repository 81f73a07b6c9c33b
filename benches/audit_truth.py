#!/usr/bin/env python3
"""Compares an audit with the planted faults of demonstrations whose truth is known.

    re4-pipe audit PIPELINE.toml --json > audit.json
    benches/audit_truth.py audit.json TRUTH.json [--modes ARTIFACTS]

TRUTH.json maps demonstrations to their planted faults (kind, first, end: half-open frames), and says which ones are clean.
`audit_truth.json` next to this script lists the codes that name each kind. A fault counts as found if a finding of such a code
touches its frames, extended by 6 frames on both sides; for faults of the whole demonstration the name decides. For copies, either
twin counts. The column "tight" counts findings whose first and last frame are both within 6 frames of the fault's.

Prints one line per kind, findings on clean demonstrations, and faults that were missed. Exit code 1 if fewer than 95 % are found
or a clean demonstration has an error or a warning.
"""

import json
import pathlib
import sys

SLACK = 6


def main():
    audit = json.load(open(sys.argv[1]))
    truth = json.load(open(sys.argv[2]))
    names = json.load(open(pathlib.Path(__file__).with_suffix(".json")))
    findings = {}
    for finding in audit["findings"]:
        findings.setdefault(finding["demo"], []).append(finding)
    copies = {}
    for finding in audit["findings"]:
        if finding["code"] in ("duplicate", "near_duplicate"):
            copies.setdefault(finding["demo"], set()).add(finding.get("twin") or finding["message"])
    table, missed, false = {}, [], []
    for demo, own in truth.items():
        for fault in own["faults"]:
            kind = fault["kind"]
            codes = names.get(kind, [kind])
            hits = [f for f in findings.get(demo, []) if f["code"] in codes]
            whole = fault["first"] == 0 and fault["end"] == own["frames"]
            near = [f for f in hits if whole or touches(f, fault)]
            if kind.startswith("dup") and not near:
                # The finding may be on the other twin and name this demonstration.
                near = [
                    f
                    for f in audit["findings"]
                    if f["code"] in codes and demo in f["message"].replace(",", " ").replace(":", " ").split()
                ]
            tight = [f for f in near if whole or is_tight(f, fault)]
            found, planted, exact = table.get(kind, (0, 0, 0))
            table[kind] = (found + bool(near), planted + 1, exact + bool(tight))
            if not near:
                got = [(f["code"], f["first_frame"], f["end_frame"]) for f in findings.get(demo, []) if f["code"] != "seam"]
                missed.append(f"{demo} {kind} {fault['first']}-{fault['end']} {fault['note']}: {got}")
        if own["clean"]:
            for f in findings.get(demo, []):
                twin = f["code"] in ("duplicate", "near_duplicate")
                if f["severity"] in ("error", "warning") and not twin:
                    false.append(f"{demo} {own['style']} {f['severity']} {f['code']}: {f['message']}")
    clean = sum(own["clean"] for own in truth.values())
    print(f"{'kind':24} found planted tight")
    for kind, (found, planted, exact) in sorted(table.items()):
        print(f"{kind:24} {found:5} {planted:7} {exact:5}{'' if found == planted else '   <'}")
    found = sum(row[0] for row in table.values())
    planted = sum(row[1] for row in table.values())
    tight = sum(row[2] for row in table.values())
    print(f"{'all':24} {found:5} {planted:7} {tight:5}   {100 * found / planted:.1f} %")
    print(f"{len(false)} errors and warnings on {clean} clean demonstrations")
    print("\n".join(["", "missed:", *missed, "", "false:", *false]))
    extra = {}
    for demo, own in truth.items():
        kinds = {code for fault in own["faults"] for code in names.get(fault["kind"], [])}
        for f in findings.get(demo, []):
            if f["code"] not in kinds and f["severity"] != "note" and not own["clean"]:
                extra.setdefault(f["code"], []).append(f"{demo} ({own['group']})")
    print("\nother errors and warnings on faulty demonstrations:")
    for code, demos in sorted(extra.items()):
        print(f"  {code}: {', '.join(demos)}")
    return found < 0.95 * planted or bool(false)


def touches(finding, fault):
    return finding["first_frame"] < fault["end"] + SLACK and finding["end_frame"] > fault["first"] - SLACK


def is_tight(finding, fault):
    return abs(finding["first_frame"] - fault["first"]) <= SLACK and abs(finding["end_frame"] - fault["end"]) <= SLACK


sys.exit(main())
