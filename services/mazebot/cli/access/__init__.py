"""Keys of a stack, and what each lets its owner do."""
