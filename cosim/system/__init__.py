"""A master for any FMUs: a graph of components, from Python or an SSP file, stepped compiled."""
