"""moto's server, with puts one at a time. moto looks for the object and then writes it without a lock, so that under load two conditional
puts could create the same object, which S3 excludes."""

import sys
import threading

from moto.s3.responses import S3Response
from moto.server import main

lock, put_object = threading.Lock(), S3Response.put_object


def one_at_a_time(self):
    with lock:
        return put_object(self)


S3Response.put_object = one_at_a_time
main(sys.argv[1:])
