from .access import Access as Access
from .meshcat_page import open_meshcat as open_meshcat
from .site import Site as Site
