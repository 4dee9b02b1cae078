"""The form of a byte on a serial line; without the line itself, which only Linux opens."""

from typing import Literal

Form = Literal["8N1", "8E2"]  # data bits, parity, stop bits
