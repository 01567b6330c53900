"""A scene as one HTML file that shows itself in any browser, without a network."""

from instok3d.webpage.page import write_page

__all__ = ["write_page"]
