"""The one place for certificates: one certifier a kind of loop, and the tests of what plant and controller say."""
