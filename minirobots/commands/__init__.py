"""The commands of `minirobots`, one module each; the file's name is the command's.

A module has the first line of its docstring as the command's purpose and the functions

- `run(options, progress)`: do the work. The type of `options`, a subclass of
  `minirobots.options.CommandOptions`, is the command line; `progress` receives what takes long.
- `show(options, result)`, if there is one: print what `run` returned, for people, and return what
  `--json` prints if that is something else. Without it `run` returns a dict, whose entries are
  printed.
- `failed(result)`, if there is one: whether the exit status is 1.

All else is done by `minirobots.runner`. Modules import only what their options need; functions
import the rest, so that every `--help` comes at once.
"""
