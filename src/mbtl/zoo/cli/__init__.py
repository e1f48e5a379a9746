"""Commands of the laboratory, one module per command; `mbtl.zoo.provider` names them."""
