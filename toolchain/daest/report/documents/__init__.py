"""Result documents: the JSON content of every command, from its result value."""
