"""A scene in the browser, to look at and to edit; needs the extra `view`."""
