"""Words: how results, decisions and numbers are said, from the data, for every page and command alike."""
