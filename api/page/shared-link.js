// The worker that holds the link of all windows of this browser. It ends with the last of them.
import { Link } from "./link.js";

const listening = new Set();
const link = new Link((message) => listening.forEach((port) => port.postMessage(message)), false);

onconnect = ({ ports: [port] }) => {
  port.onmessage = async ({ data }) => {
    if (data.kind === "listen") {
      listening.add(port);
      link.listen();
      port.postMessage({ kind: "before", data: link.last });
    } else if (data.kind === "hush") {
      listening.delete(port);
      if (listening.size === 0) link.hush();
    } else {
      const answer = await link.command(data.path, data.body, data.headers);
      port.postMessage({ kind: "answer", id: data.id, data: answer });
    }
  };
};
