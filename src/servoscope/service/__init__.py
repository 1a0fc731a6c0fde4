"""A model behind HTTP, for programs in any language."""
