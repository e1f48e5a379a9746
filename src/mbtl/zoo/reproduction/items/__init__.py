"""One module per item; `mbtl.zoo.reproduction.runner` lists them."""
