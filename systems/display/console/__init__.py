"""The console: one page with the world, the slices, the strips and the controls of a run.

The page is served by an embedded Bokeh server behind the site's rule. It imports `display` and
everything that `display` imports. Bokeh is imported only when a console is opened.
"""
