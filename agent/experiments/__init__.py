"""Many runs of training at once, evaluated exactly: of one configuration, or of an experiment's.

An experiment (Section V, and what it leaves open) is a set of variants; each variant is a folder of
runs as `minirobots train` makes it, and all variants share their seeds. Figures are drawn from
the results by `analysis`.
"""
