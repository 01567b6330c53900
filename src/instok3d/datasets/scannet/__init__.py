"""ScanNet in its original files: .sens scans, id map archives, label table, splits."""
