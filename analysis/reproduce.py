"""`python -m analysis.reproduce`: the command `minirobots reproduce`."""

from cosim.base.errors import end_at_interrupt

if __name__ == "__main__":
    end_at_interrupt()
    from minirobots.runner import run_named  # whose imports take long

    run_named("reproduce")
