from .drawing import MonitorScreen as MonitorScreen
from .drawing import readings as readings
from .monitor import Monitor as Monitor
from .scanner_monitor import ScannerMonitor as ScannerMonitor
from .scene_page import ScenePage as ScenePage
from .views import View as View
from .views import monitor_views as monitor_views
