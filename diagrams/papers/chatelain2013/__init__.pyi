from .reproduction import Protocol as Protocol
from .reproduction import bent_insertion as bent_insertion
from .reproduction import reproduce as reproduce
from .reproduction import study_cases as study_cases
