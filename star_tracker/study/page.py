from star_tracker.study.troubles import QUANTITIES
def label(record):
    if record.sweep in QUANTITIES:
        return QUANTITIES[record.sweep].label(record.value)
    return f"map {record.value:g}" if record.sweep == "map" else str(record.value)
def write_page(study, found, path): pass
