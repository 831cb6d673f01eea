from .insertion_detector import InsertionDetector as InsertionDetector
from .insertion_detector import InsertionDetectorParameters as InsertionDetectorParameters
from .insertion_detector import closest_side as closest_side
from .insertion_detector import detect_insertion as detect_insertion
from .volume_difference import top_differences as top_differences
from .volume_gate import VolumeGate as VolumeGate
from .volume_memory import VolumeMemory as VolumeMemory
from .volume_plausibility import VolumePlausibilityParameters as VolumePlausibilityParameters
