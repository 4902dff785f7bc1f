"""Schema 3 to 4: a run notes the tool that was on the flange; nothing for those before."""

SQL = "ALTER TABLE runs ADD COLUMN tool TEXT;"
