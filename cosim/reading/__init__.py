"""Recordings read back: any Rerun file as arrays (`rrd`), and an episode (`episode`)."""
