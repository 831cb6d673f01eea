from .reproduction import reproduce as reproduce
from .runs import run_needle as run_needle
