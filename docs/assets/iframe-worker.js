// The search runs in a worker, which browsers refuse to start from a file. Where the site is opened
// as a file, a hidden frame of the same page takes the worker's place.
if (location.protocol === "file:") {
  window.Worker = window.IFrameWorker = class extends EventTarget {
    constructor(url) {
      super();
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      document.body.appendChild(this.frame);
      const address = new URL(url, document.baseURI).href;
      const page = this.frame.contentDocument;
      page.open();
      page.write(`<html><body><script>
        postMessage = data => parent.dispatchEvent(new MessageEvent("frame-worker", {data}));
        importScripts = (...urls) => urls.reduce((before, url) => before.then(() =>
          new Promise((done, failed) => {
            const script = document.createElement("script");
            Object.assign(script, {src: url, onload: done, onerror: failed});
            document.body.appendChild(script);
          })), Promise.resolve());
      <\/script><script src="${address}"><\/script></body></html>`);
      page.close();
      this.told = event => {
        const copy = new MessageEvent("message", {data: event.data});
        this.dispatchEvent(copy);
        if (this.onmessage) this.onmessage(copy);
      };
      window.addEventListener("frame-worker", this.told);
    }
    postMessage(data) {
      this.frame.contentWindow.dispatchEvent(new MessageEvent("message", {data}));
    }
    terminate() {
      window.removeEventListener("frame-worker", this.told);
      this.frame.remove();
    }
  };
}
