"""From a log to activities, by episode: what is up to date is skipped, what is bad is set aside."""
