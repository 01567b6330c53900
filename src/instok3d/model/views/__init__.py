"""Many views: taken in windows, their groups joined, free space between them used."""
