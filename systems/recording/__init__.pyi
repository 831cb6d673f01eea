from .nrrd import write_volume as write_volume
from .recording import Recording as Recording
from .recording_writer import RecordingWriter as RecordingWriter
from .side_files import read_truth as read_truth
from .volume_collector import VolumeCollector as VolumeCollector
from .volume_player import VolumePlayer as VolumePlayer
from .volume_recorder import VolumeRecorder as VolumeRecorder
