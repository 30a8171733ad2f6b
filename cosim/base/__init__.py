"""Numbers, files and errors: the base of all other packages."""
