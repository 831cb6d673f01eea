from .mcap_log import McapLog as McapLog
from .rerun_log import RerunLog as RerunLog
from .run_stream import Surroundings as Surroundings
from .run_stream import open_viewer_log as open_viewer_log
from .run_stream import write_run as write_run
from .viewer_log import ViewerLog as ViewerLog
