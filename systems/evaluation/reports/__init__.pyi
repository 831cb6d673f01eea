from .plots import plot_run as plot_run
from .report import report_page as report_page
from .track_plots import PictureRecorder as PictureRecorder
from .track_plots import read_pictures as read_pictures
