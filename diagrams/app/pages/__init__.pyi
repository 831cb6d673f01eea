from .pacer import Pacer as Pacer
from .pages import Pages as Pages
from .pages import open_pages as open_pages
from .real_time import RealTime as RealTime
