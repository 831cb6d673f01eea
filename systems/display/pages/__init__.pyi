from .access import Access as Access
from .meshcat_page import open_meshcat as open_meshcat
from .page_messages import checked_message as checked_message
from .site import Site as Site
