"""Result documents as text for the terminal, one module per command. They read the documents alone."""
