"""A payload in Python: a sounder that is not there. It reads where the boat is, and reports a depth and where it was measured.

A real one opens its instrument instead, and reports as often as it measures.
"""

import json
import math
import sys

print("the sounder starts", file=sys.stderr)
for line in sys.stdin:  # ends when the boat's program ends
    told = json.loads(line)
    if "event" in told:
        print(f"the boat: {told}", file=sys.stderr)
    elif told["latitude_deg"] is not None:
        depth_m = 12.0 + 3.0 * math.sin(1e4 * told["latitude_deg"]) * math.sin(1e4 * told["longitude_deg"])
        print(json.dumps({"depth_m": round(depth_m, 2), "bottom": "mud" if depth_m > 12.0 else "sand"}), flush=True)
