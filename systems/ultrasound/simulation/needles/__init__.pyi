from .needle_echo import NeedleEchoParameters as NeedleEchoParameters
from .needle_kind import NeedleKind as NeedleKind
from .needle_kind import load_needle as load_needle
