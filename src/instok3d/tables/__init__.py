"""The paper's tables on rooms, by one command: trained, measured, written."""
