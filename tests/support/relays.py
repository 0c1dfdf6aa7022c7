"""A TCP relay that can be cut, and a broker that acknowledges nothing."""

import socket
import ssl
import threading


class Cable:
    """A TCP relay that can be cut; it lets connections through again at once."""

    def __init__(self, to_port):
        self._to = to_port
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self._ends = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        while True:
            try:
                near, _ = self._server.accept()
            except OSError:
                return
            far = socket.create_connection(("127.0.0.1", self._to))
            self._ends += [near, far]
            for a, b in ((near, far), (far, near)):
                threading.Thread(target=self._pump, args=(a, b), daemon=True).start()

    @staticmethod
    def _pump(a, b):
        try:
            while chunk := a.recv(65536):
                b.sendall(chunk)
        except OSError:
            pass
        finally:
            for end in (a, b):
                end.close()

    def cut(self):
        for end in self._ends:
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                continue
        self._ends = []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._server.close()
        self.cut()


class Deaf:
    """Takes an MQTT 5 connection and acknowledges nothing; counts PUBLISH packets.

    Args:
        last_words: what it answers to the first PUBLISH of each connection before it hangs up, if it does.
    """

    CONNACK = bytes([0x20, 3, 0, 0, 0])

    def __init__(self, *last_words):
        self._last_words = list(last_words)
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self.publishes = 0
        self._connections = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        while True:
            try:
                connection, _ = self._server.accept()
            except OSError:
                return
            self._connections.append(connection)
            threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection):
        stream = connection.makefile("rb")
        try:
            while head := stream.read(1):
                length, shift = 0, 0
                while True:
                    byte = stream.read(1)[0]
                    length |= (byte & 127) << shift
                    shift += 7
                    if byte < 128:
                        break
                stream.read(length)
                if head[0] >> 4 == 1:
                    connection.sendall(self.CONNACK)
                elif head[0] >> 4 == 3:
                    self.publishes += 1
                    if self._last_words:
                        connection.sendall(self._last_words.pop(0))
                        stream.detach().close()  # what is still to be read makes it a reset
                        connection.close()
                        return
        except (OSError, IndexError, ssl.SSLError):
            pass

    @property
    def connections(self):
        return len(self._connections)

    def hang_up(self):
        for connection in self._connections:
            connection.shutdown(socket.SHUT_RDWR)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._server.close()
