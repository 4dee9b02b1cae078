"""The console's end of the link to boats: frames, routes, radios, and the record of a session."""
