"""How the tables of an older karolos become those of this one: a module per version, named v<version it leads to>.

Each has `migrate(operations)`, which works inside one transaction, with foreign keys off on SQLite. A migration is
frozen once it was released: it names tables and columns itself, and imports no model.
"""
