"""The commands of `minirobots`, one module each; the file's name is the command's.

A module has the first line of its docstring as the command's purpose and the functions

- `run(options, progress)`, a generator: do the work, yield what `--json` prints, then print it for
  people. The type of `options`, a subclass of `minirobots.options.CommandOptions`, is the command
  line; `progress` receives what takes long. A function that returns a dict instead has its entries
  printed.
- `failed(result)`, if there is one: whether what was yielded makes the exit status 1.

All else is done by `minirobots.runner`. Modules import only what their options need; functions
import the rest, so that every `--help` comes at once.
"""
