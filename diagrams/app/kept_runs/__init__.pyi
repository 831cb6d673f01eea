from .explain import ExplainedRun as ExplainedRun
from .explain import explanation_table as explanation_table
from .explain import read_explained_run as read_explained_run
from .kept_run import KeptRun as KeptRun
from .replay import Replay as Replay
from .replay import read_replay as read_replay
