"""How tests start programs that go on by themselves."""

# A test's process that is killed asks them to end; `setpriv` becomes the program, so that it keeps its number.
ENDS_WITH_US = "setpriv", "--pdeathsig", "TERM"
