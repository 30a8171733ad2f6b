"""The FMUs before judges not written here: validators, and importers that simulate them."""
