#!/usr/bin/env python3
"""A payload in Python: it reads the switch in the bilge, and tells the boat whether there is water.

bilge.py /sys/class/gpio/gpio17/value     a file that is 1 in water
bilge.py --wet-after 40                   for a trial: water comes after so many seconds
"""

import json
import sys
from pathlib import Path


def is_wet(words: list[str], sailed_s: float) -> bool:
    if words[0] == "--wet-after":
        return sailed_s >= float(words[1])
    return Path(words[0]).read_text().strip() == "1"


began_ns = None
told_s = -1
for line in sys.stdin:  # ends when the boat's program ends
    told = json.loads(line)
    if "event" in told:
        continue
    began_ns = began_ns or told["utc_ns"]
    sailed_s = (told["utc_ns"] - began_ns) / 1e9
    wet = is_wet(sys.argv[1:], sailed_s)
    if int(sailed_s) != told_s:
        told_s = int(sailed_s)
        print(json.dumps({"command": "tell", "values": {"leak": int(wet)}}), flush=True)
    print(json.dumps({"leak": wet}), flush=True)
