"""Files in and out: YAML read, checked and written; folders of results that appear as a whole."""
