"""Models and scenes on the Hugging Face hub: named, fetched, checked, pushed."""
