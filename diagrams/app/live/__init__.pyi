from .bridge import play_live as play_live
from .bridge import record_live as record_live
from .serve import live_senders as live_senders
from .serve import opened as opened
from .track_live import live_volumes as live_volumes
