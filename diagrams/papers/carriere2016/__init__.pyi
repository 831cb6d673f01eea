from .reproduction import reproduce as reproduce
from .reproduction import run_needle as run_needle
