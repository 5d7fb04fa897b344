"""From views to numbers and files: solving, comparing, exporting, passports, studies."""
