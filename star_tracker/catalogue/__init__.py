"""Guide stars and what is computed of them once: sky index, pairs, patterns, database."""
