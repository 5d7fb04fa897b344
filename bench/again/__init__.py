"""`verify --again`: recordings measured again, solved again, and the results compared."""
