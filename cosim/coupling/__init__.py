"""The master: FMUs and bodies, tick by tick, under the robots' steering."""
