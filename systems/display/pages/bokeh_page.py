"""A Bokeh application as a page of a site: every page that opens has a document of its own."""

import logging
from collections.abc import Callable

from bokeh.application import Application
from bokeh.application.handlers import FunctionHandler
from bokeh.document import Document
from bokeh.embed.server import server_html_page_for_session
from bokeh.server.tornado import BokehTornado
from bokeh.server.views.doc_handler import DocHandler
from bokeh.server.views.ws import WSHandler
from tornado.ioloop import IOLoop
from tornado.web import HTTPError

from sonoservo.systems.display.pages.site import MAX_MESSAGE, Guarded, Site


class _Page(Guarded, DocHandler):
    """Serves the page, and leaves the token as a cookie."""

    async def get(self, *args: object, **kwargs: object) -> None:
        session = await self.get_session()
        page = server_html_page_for_session(
            session,
            # Without Bokeh's tables, widgets and formulas, which are larger than the rest.
            resources=self.application.resources().clone(components=["bokeh"]),
            title=session.document.title,
            template=session.document.template,
        )
        self.set_header("Content-Type", "text/html")
        await self.finish(page)


class _Socket(Guarded, WSHandler):
    """Connects a page to its document."""

    def check_origin(self, origin: str) -> bool:
        return True  # the site's rule has checked it


class _Nothing(Guarded):
    """Takes the place of Bokeh's scripts for embedding, which no page of ours asks for."""

    def initialize(self, **_: object) -> None:
        pass

    def get(self) -> None:
        raise HTTPError(404)


def open_bokeh_page(site: Site, *, page: str, title: str, make: Callable[[Document], None]) -> None:
    """Add a page to a site that is served by Bokeh, on the site's own thread."""
    # A page that closes early is no news, and one that sends what no page does is disconnected, or
    # told so; it must not fill the terminal with tracebacks.
    logging.getLogger("bokeh").setLevel(logging.CRITICAL)

    def start() -> BokehTornado:
        application = BokehTornado(
            {"/": Application(FunctionHandler(make))},
            prefix=f"/{page}",
            use_index=False,
            include_headers=[],
            include_cookies=[],  # the token among them would be written into the page
            websocket_max_message_size_bytes=MAX_MESSAGE,
            access=site.access,
            cookie=site.cookie,
            log_function=lambda handler: None,
        )
        context = {
            "application_context": application.applications["/"],
            "bokeh_websocket_path": f"/{page}/ws",
        }
        # They come before Bokeh's own handlers of the same paths.
        application.add_handlers(
            ".*",
            [
                (f"/{page}/?", _Page, context),
                (f"/{page}/ws", _Socket, context),
                (f"/{page}/(?:autoload.js|metadata|favicon.ico)", _Nothing),
            ],
        )
        application.initialize(IOLoop.current())
        application.start()
        return application

    application = site.ask(start)
    site.add(page, title, [], rest=application, close=application.stop)
