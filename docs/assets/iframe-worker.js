"use strict";
// The search of a page that is opened from disk: browsers start no worker from a file, so that its
// script runs in a hidden frame instead. Pages from a server keep the browser's own worker.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(address) {
      super();
      const frame = document.createElement("iframe"), waiting = [];
      frame.hidden = true;
      document.body.append(frame);
      const inside = frame.contentWindow;
      inside.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      this.postMessage = (data) => waiting.push(data); // until the script has been loaded
      const script = inside.document.createElement("script");
      script.src = address;
      script.onload = () => {
        this.postMessage = (data) => inside.dispatchEvent(new inside.MessageEvent("message", { data }));
        waiting.forEach(this.postMessage);
      };
      script.onerror = () => this.dispatchEvent(new ErrorEvent("error"));
      inside.document.body.append(script);
      this.terminate = () => frame.remove();
    }
  };
}
