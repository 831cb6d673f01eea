from .estimates_table import estimates_csv as estimates_csv
from .locate import LocatedNeedle as LocatedNeedle
from .locate import locate_in as locate_in
from .locate import locate_in_recording as locate_in_recording
from .reconstruct import ReconstructedRecording as ReconstructedRecording
from .track import track_recording as track_recording
from .track import tracker_parameters as tracker_parameters
from .tracked_recording import TrackedRecording as TrackedRecording
