"""Small problems of every kind, to tell strategies apart (`mbtl.zoo.small.problems`)."""
