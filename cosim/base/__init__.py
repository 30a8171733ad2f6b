"""Numbers, files and refusals: what everything else stands on."""
