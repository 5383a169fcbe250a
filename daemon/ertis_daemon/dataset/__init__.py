"""Making and checking labelled data sets; the files themselves are ``ertis_driver.dataset``'s."""
